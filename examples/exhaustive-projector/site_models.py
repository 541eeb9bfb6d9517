"""The map and models that were received, until a set of them is whole (docs/contract.md, "Models")."""

from __future__ import annotations

import hashlib
import zlib
from copy import deepcopy

import numpy as np
from comparison import Building, coarse, distance_field
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.message import Message

FORMAT = 2
FREE, OCCUPIED = 0, 100
NO_WALL = 65535


class SiteModels:
    """Takes messages in any order; `whole` is the newest set that has come with all its parts."""

    def __init__(self) -> None:
        self.refused = 0
        self.whole: tuple[ModelSet, list[str], Building] | None = None
        self._maps: dict[str, Grid] = {}
        self._models: dict[str, RegionModel] = {}
        self._set: ModelSet | None = None

    def put(self, message: Message) -> None:
        """Takes a map, a model or a set; what is damaged or of another format is counted."""
        if isinstance(message, Grid):
            self._maps[map_version(message)] = message
        elif isinstance(message, RegionModel):
            if message.format == FORMAT and model_version(message) == message.version:
                self._models[message.version] = message
            else:
                self.refused += 1
        elif isinstance(message, ModelSet):
            self._set = message
        self._complete()

    def _complete(self) -> None:
        wanted = self._set
        if wanted is None or (self.whole and self.whole[0].version == wanted.version):
            return
        versions = [entry.version for entry in wanted.entries]
        if wanted.map_version in self._maps and all(version in self._models for version in versions):
            models = [self._models[version] for version in versions]
            names = [model.region for model in models]
            self.whole = wanted, names, building(self._maps[wanted.map_version], models)


def building(grid: Grid, models: list[RegionModel]) -> Building:
    """What a scan is compared with."""
    cells = np.frombuffer(grid.data, dtype=np.uint8).reshape(-1, grid.column_count)
    resolution = grid.cell_size.x
    positions = [
        np.column_stack([m.index_x, m.index_y]) * m.spacing + np.array([m.origin_x, m.origin_y])
        for m in models
    ]
    return Building(
        panoramas=np.concatenate([coarse(_ranges(model)) for model in models]),
        positions=np.concatenate(positions),
        regions=np.repeat(np.arange(len(models)), [len(p) for p in positions]),
        field=distance_field(cells == OCCUPIED, resolution),
        free=cells == FREE,
        origin=_origin(grid),
        resolution=resolution,
    )


def _ranges(model: RegionModel) -> np.ndarray:
    """Panoramas (P, N), m, +inf where no wall is in sight."""
    packed = np.frombuffer(zlib.decompress(model.panoramas), dtype="<u2").reshape(-1, model.beams)
    return np.where(packed == NO_WALL, np.inf, packed * model.range_unit).astype(np.float32)


def model_version(model: RegionModel) -> str:
    """SHA-256 of the message without `version`, `panoramas` inflated; empty where they do not inflate."""
    plain = deepcopy(model)
    plain.ClearField("version")
    try:
        plain.panoramas = zlib.decompress(model.panoramas)
    except zlib.error:
        return ""
    return hashlib.sha256(plain.SerializeToString(deterministic=True)).hexdigest()


def map_version(grid: Grid) -> str:
    """SHA-256 of the cells, then of resolution, x, y, yaw, rows and columns as little-endian float64."""
    rows = len(grid.data) // max(grid.column_count, 1)
    numbers = np.array([grid.cell_size.x, *_origin(grid), rows, grid.column_count], dtype="<f8")
    return hashlib.sha256(grid.data + numbers.tobytes()).hexdigest()


def _origin(grid: Grid) -> np.ndarray:
    """x, y (m) and yaw (rad) of the corner of cell (0, 0)."""
    turn = grid.pose.orientation
    yaw = np.arctan2(2.0 * (turn.w * turn.z + turn.x * turn.y), 1.0 - 2.0 * (turn.y**2 + turn.z**2))
    return np.array([grid.pose.position.x, grid.pose.position.y, yaw])
