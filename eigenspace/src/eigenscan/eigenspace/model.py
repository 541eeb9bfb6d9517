"""The model of a region as it travels: panoramas on a position grid and their eigenspace."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, Analysis, RegionSpace, region_space, searched
from eigenscan.eigenspace.panorama import resample
from eigenscan.eigenspace.space_message import space_from_message, space_to_message
from eigenscan.geometry.gridmap import FINEST_M
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.schemas import model_pb2
from numpy.typing import NDArray

FORMAT = 2
WITHOUT_SPACE = 1
"""The first release's format: its eigenspace is of plain ranges, which no projector searches."""
RANGE_UNIT = 0.002
"""m per step of a stored range; the farthest is 131 m."""
NO_WALL = np.uint16(65535)
_MOST_BEAMS = 65536
MOST_BYTES = 2**28
"""Most bytes of a region's panoramas, inflated: 7,000 m2 at 0.25 m and 0.5 degrees. More is hostile."""
MOST_SMALL_BYTES, MOST_TIMES = 2**26, 100
"""A region with more bytes of panoramas than the first shrinks to a tenth at best, never to a hundredth."""
MOST_CELLS_APART = 10**9
"""Grid steps of a position from the region's origin, at most: of two, 32 bits hold the difference."""
_COMPRESSION = 1
"""zlib level: higher ones take four times as long to save an eighth."""


class ModelError(ValueError):
    """A model that cannot be used; the message names the region and the fault."""


@dataclass(frozen=True)
class RegionModel:
    """The panoramas of one region's positions, and its eigenspace for the declared lidar.

    `index` (P, 2) int32: grid indices (x, y) of the positions, `spacing` m apart, from `origin` (2,) m in the
    frame `frame_id`. `ranges` (P, N) uint16 in steps of `range_unit` m; NO_WALL if no wall is in sight.
    `outline` (K, 2) m.
    """

    region: str
    frame_id: str
    spacing: float
    origin: NDArray[np.float64]
    index: NDArray[np.int32]
    ranges: NDArray[np.uint16]
    space: RegionSpace
    outline: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 2)))
    range_unit: float = RANGE_UNIT

    @classmethod
    def of(
        cls,
        analysis: Analysis,
        region: str,
        frame_id: str,
        spacing: float,
        origin: NDArray[np.float64],
        index: NDArray[np.int32],
        ranges: NDArray[np.uint16],
        outline: NDArray[np.float64],
    ) -> RegionModel:
        """Makes a model of panoramas and their eigenspace. Raises ValueError without panoramas."""
        space, _ = _derived(ranges, RANGE_UNIT, index, spacing, analysis)
        return cls(region, frame_id, spacing, origin, index, ranges, space, outline)

    def with_ranges(self, index: NDArray[np.int32], ranges: NDArray[np.uint16]) -> RegionModel:
        """The same region with other positions and panoramas, by the same analysis."""
        space, _ = _derived(ranges, self.range_unit, index, self.spacing, self.space.analysis)
        return replace(self, index=index, ranges=ranges, space=space)

    def derive(self, analysis: Analysis) -> tuple[RegionSpace, NDArray[np.float32]]:
        """The region's eigenspace for another kind of lidar, and the coefficients (S, H, M) there.

        The coefficients are of the positions that `searched` names, as `sampled` gives them.
        """
        return _derived(self.ranges, self.range_unit, self.index, self.spacing, analysis)

    @property
    def positions(self) -> NDArray[np.float64]:
        """Map-frame positions (P, 2), m."""
        return self.origin + self.index * self.spacing

    @property
    def panoramas(self) -> NDArray[np.float32]:
        """Ranges (P, N), m, +inf if no wall is in sight."""
        return _metres(self.ranges, self.range_unit)

    @property
    def analysed(self) -> NDArray[np.float32]:
        """Panoramas (P, ANALYSIS_TURN), m, at the step of the analysis, from which eigenspaces are made."""
        return resample(self.panoramas, ANALYSIS_TURN)

    @cached_property
    def version(self) -> str:
        """SHA-256 of the content, hex: of the message without `version` and with `panoramas` inflated."""
        return _digest(self._message(b""), self.ranges)

    @cached_property
    def packed(self) -> bytes:
        """The ranges as they travel: little-endian, zlib."""
        return zlib.compress(self.ranges.astype("<u2").tobytes(), _COMPRESSION)

    def check(self) -> None:
        """Raises ModelError or ValueError for numbers that no region of a building has."""
        message = self._message(b"")
        check(message)
        space_from_message(message.space)

    @property
    def entry(self) -> model_pb2.ModelSet.Entry:
        """The model's entry in a set."""
        return model_pb2.ModelSet.Entry(
            region=self.region,
            version=self.version,
            size=self.to_message().ByteSize(),
            walls_in_sight=self.walls_in_sight,
        )

    @property
    def walls_in_sight(self) -> float:
        """Of the beams of its panoramas those that meet a wall: where the map is open, few do."""
        return float(np.mean(self.ranges != NO_WALL))

    def to_message(self) -> model_pb2.RegionModel:
        """The message of the same name, with its version."""
        message = self._message(self.packed)
        message.version = self.version
        return message

    def _message(self, panoramas: bytes) -> model_pb2.RegionModel:
        return model_pb2.RegionModel(
            format=FORMAT,
            region=self.region,
            frame_id=self.frame_id,
            spacing=self.spacing,
            origin_x=float(self.origin[0]),
            origin_y=float(self.origin[1]),
            beams=self.ranges.shape[1],
            index_x=self.index[:, 0].tolist(),
            index_y=self.index[:, 1].tolist(),
            panoramas=panoramas,
            range_unit=self.range_unit,
            outline_x=self.outline[:, 0].tolist(),
            outline_y=self.outline[:, 1].tolist(),
            space=space_to_message(self.space),
        )

    @classmethod
    def from_message(cls, message: model_pb2.RegionModel) -> RegionModel:
        """Model of a message. Raises ModelError if it has another format, is damaged or empty.

        For the first release's format the eigenspace is derived by the default analysis. The version stays
        the received one, so such a model is searched and not published again.
        """
        check(message)
        ranges = _inflate(message)
        version = _digest(message, ranges)
        if version != message.version:
            raise ModelError(
                f"region {message.region!r}: content is {version[:12]}, not the version "
                f"{message.version[:12]!r} it claims: damaged on the way, fetch it again"
            )
        index = np.column_stack([message.index_x, message.index_y]).astype(np.int32)
        try:
            if message.format == WITHOUT_SPACE:
                space, _ = _derived(ranges, message.range_unit, index, message.spacing, Analysis())
            else:
                space = space_from_message(message.space)
        except ValueError as error:
            raise ModelError(f"region {message.region!r}: space: {error}") from error
        model = cls(
            region=message.region,
            frame_id=message.frame_id,
            spacing=message.spacing,
            origin=np.array([message.origin_x, message.origin_y]),
            index=index,
            ranges=ranges,
            space=space,
            outline=np.column_stack([message.outline_x, message.outline_y]),
            range_unit=message.range_unit,
        )
        model.__dict__["version"] = version  # of its cached property: hashed once
        return model


def _derived(
    ranges: NDArray[np.uint16], unit: float, index: NDArray[np.int32], spacing: float, analysis: Analysis
) -> tuple[RegionSpace, NDArray[np.float32]]:
    coarse = resample(_metres(ranges, unit), ANALYSIS_TURN)
    return region_space(coarse, searched(index, spacing)[0], analysis)


def _metres(ranges: NDArray[np.uint16], unit: float) -> NDArray[np.float32]:
    return np.where(ranges == NO_WALL, np.float32(np.inf), ranges * np.float32(unit))


def quantize(panoramas: NDArray[np.float32], unit: float = RANGE_UNIT) -> NDArray[np.uint16]:
    """Ranges of any shape, m, in steps of `unit`; NO_WALL for +inf and for ranges that do not fit."""
    with np.errstate(invalid="ignore"):
        steps = np.rint(panoramas * np.float32(1.0 / unit))
        return np.where(steps < NO_WALL, steps, np.float32(NO_WALL)).astype(np.uint16)


def model_set(
    models: Sequence[RegionModel], map_version: str, frame_id: str, free_area_m2: float
) -> model_pb2.ModelSet:
    """The set of `models` and their map; a projector takes it whole or not at all."""
    return set_of([m.entry for m in models], map_version, frame_id, free_area_m2)


def set_of(
    entries: Sequence[model_pb2.ModelSet.Entry],
    map_version: str,
    frame_id: str,
    free_area_m2: float,
    floors: Sequence[model_pb2.ModelSet.Floor] = (),
) -> model_pb2.ModelSet:
    """The set of the models that `entries` name, and their map with its floors."""
    return model_pb2.ModelSet(
        version=set_version(map_version, [entry.version for entry in entries]),
        frame_id=frame_id,
        map_version=map_version,
        entries=entries,
        free_area_m2=free_area_m2,
        floors=floors,
    )


def set_version(map_version: str, versions: Sequence[str]) -> str:
    """SHA-256, hex, over the versions' text: the map's, then the regions' in order, one a line."""
    return hashlib.sha256("\n".join([map_version, *versions]).encode()).hexdigest()


def panorama_bytes(positions: int, beams: int) -> int:
    """Bytes of a region's panoramas, inflated: 16 bits a range."""
    return 2 * positions * beams


def check(message: model_pb2.RegionModel) -> None:
    """Raises ModelError for fields that do not fit together."""
    name = f"region {message.region!r}"
    if message.format not in (WITHOUT_SPACE, FORMAT):
        raise ModelError(
            f"{name}: model format {message.format}, this version reads {FORMAT}: build the models again, "
            "eigenscan build MAP -o MODEL"
        )
    if not len(message.index_x) or len(message.index_x) != len(message.index_y):
        raise ModelError(f"{name}: {len(message.index_x)} x and {len(message.index_y)} y of positions")
    numbers = {
        "spacing": message.spacing,
        "range_unit": message.range_unit,
    }
    for field_name, value in numbers.items():
        if not 0 < value <= FARTHEST_M:
            raise ModelError(f"{name}: {field_name} = {value}: expected metres above 0")
    if panorama_bytes(len(message.index_x), message.beams) > MOST_BYTES:
        raise ModelError(
            f"{name}: {len(message.index_x)} panoramas of {message.beams} beams: more than {MOST_BYTES} bytes"
        )
    # one by one: max passes over a NaN
    near = abs(message.origin_x) <= FARTHEST_M and abs(message.origin_y) <= FARTHEST_M
    if not (near and FINEST_M <= message.spacing <= FARTHEST_M):
        raise ModelError(
            f"{name}: origin ({message.origin_x:g}, {message.origin_y:g}), spacing {message.spacing:g} m: "
            "no building is there"
        )
    if max(map(abs, (*message.index_x, *message.index_y))) > MOST_CELLS_APART:
        raise ModelError(f"{name}: positions farther than {MOST_CELLS_APART} steps from its origin")
    if not 1 <= message.beams <= _MOST_BEAMS:
        raise ModelError(f"{name}: panoramas of {message.beams} beams")
    if len(message.outline_x) != len(message.outline_y):
        raise ModelError(f"{name}: {len(message.outline_x)} x and {len(message.outline_y)} y of the outline")


def _inflate(message: model_pb2.RegionModel) -> NDArray[np.uint16]:
    shape = (len(message.index_x), message.beams)
    expected = 2 * shape[0] * shape[1]
    if expected > max(MOST_SMALL_BYTES, MOST_TIMES * len(message.panoramas)):
        raise ModelError(
            f"region {message.region!r}: {len(message.panoramas)} bytes would inflate to {expected}"
        )
    inflater = zlib.decompressobj()
    try:
        raw = inflater.decompress(message.panoramas, expected + 1)
    except zlib.error as error:
        raise ModelError(f"region {message.region!r}: panoramas do not inflate: {error}") from error
    if len(raw) != expected:
        raise ModelError(f"region {message.region!r}: {len(raw)} bytes of panoramas, expected {expected}")
    return np.frombuffer(raw, dtype="<u2").astype(np.uint16).reshape(shape)


def _digest(message: model_pb2.RegionModel, ranges: NDArray[np.uint16]) -> str:
    """The version of a message with these ranges; fields that this build does not know count too."""
    plain = model_pb2.RegionModel()
    plain.CopyFrom(message)
    plain.ClearField("version")
    plain.panoramas = ranges.astype("<u2").tobytes()
    return hashlib.sha256(plain.SerializeToString(deterministic=True)).hexdigest()
