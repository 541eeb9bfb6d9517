"""Occupancy grid maps in ROS map_server form (yaml + pgm/png) and as foxglove.Grid."""

from __future__ import annotations

import hashlib
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import FARTHEST_M, from_pose3, inverse, to_pose3, transform
from eigenscan.schemas.whole import whole
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from numpy.typing import ArrayLike, NDArray

FREE, OCCUPIED, UNKNOWN = 0, 100, 255
FIELD = "occupancy"
COARSEST_M = 1.0
"""m a cell, at most: in coarser ones there are no rooms; mostly a slip of the decimal point."""
FINEST_M = 0.001
"""Least cell size, m: no lidar is finer, and endless cells would fill the memory."""
_MOST_TURNED = 2.0 * TURN
"""rad, of a map's yaw: a larger one is rather in degrees."""
MOST_CELLS = 400_000_000
"""A square kilometre in cells of 5 cm."""
SMALL_PIXELS, PIXELS_A_BYTE = 10_000_000, 10_000
"""Larger images hold at most so many pixels a byte: an empty one of 1 bit a pixel has 8,000 as PNG."""
IMAGE_FORMATS = ("PPM", "PNG", "BMP", "JPEG", "TIFF", "GIF")
"""Those that map savers write and people draw. Others may start programs, as EPS does."""
_MOST_YAML_BYTES = 10_000
MOST_NESTED = 20
_DAMAGE = (ValueError, SyntaxError, ArithmeticError, LookupError, TypeError, struct.error, MemoryError)
"""Errors of Pillow's readers for damaged images."""
_SAVED_UNKNOWN = 205.0
"""Grey that map savers write for unknown; a free_thresh above 0.196, such as Nav2's 0.25, makes it free."""


class MapError(ValueError):
    """A map that cannot be used; the message names the file, the field and the fix."""


@dataclass(frozen=True)
class GridMap:
    """Cells (H, W) uint8 of FREE, OCCUPIED or UNKNOWN; row 0 and column 0 at the origin.

    `origin` (3,): pose of the outer corner of cell (0, 0) in the map frame; `resolution` in m per cell.
    `is_received`: the origin is as a message states it. `is_lossy`: of an image whose greys are not exact.
    """

    cells: NDArray[np.uint8]
    resolution: float
    origin: NDArray[np.float64]
    is_received: bool = field(default=False, compare=False, repr=False)
    is_lossy: bool = field(default=False, compare=False, repr=False)

    @property
    def free_area(self) -> float:
        """Area of the free cells, m^2."""
        return float(np.count_nonzero(self.cells == FREE)) * self.resolution**2

    @property
    def version(self) -> str:
        """SHA-256 of the message's content, hex: who receives it finds the same."""
        # a quaternion gives one yaw in five back with another last digit, and never -0.0 or over half a turn
        origin = self.origin if self.is_received else from_pose3(to_pose3(self.origin))
        digest = hashlib.sha256(self.cells.tobytes())
        digest.update(np.array([self.resolution, *origin, *self.cells.shape]).tobytes())
        return digest.hexdigest()

    @cached_property
    def map_in_grid(self) -> NDArray[np.float64]:
        """The map frame's pose (3,) in the grid's."""
        return inverse(self.origin)

    def to_grid(self, points: ArrayLike) -> NDArray[np.float64]:
        """Map-frame points (..., 2), m, as continuous (column, row).

        Cell (r, c) spans [c, c+1) x [r, r+1).
        """
        return transform(self.map_in_grid, points) / self.resolution

    def to_map(self, grid: ArrayLike) -> NDArray[np.float64]:
        """Continuous (column, row) (..., 2) as map-frame points, m."""
        return transform(self.origin, np.asarray(grid, dtype=np.float64) * self.resolution)

    def at(self, points: ArrayLike) -> NDArray[np.uint8]:
        """Cell values at map-frame points (..., 2); UNKNOWN outside."""
        index = np.floor(self.to_grid(points)).astype(np.int64)
        height, width = self.cells.shape
        column, row = index[..., 0], index[..., 1]
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        # np.clip takes four times as long
        row, column = np.minimum(np.maximum(row, 0), height - 1), np.minimum(np.maximum(column, 0), width - 1)
        values = self.cells[row, column]
        return np.where(inside, values, np.uint8(UNKNOWN)).astype(np.uint8)


def check_grid(grid: object) -> None:
    """Raises MapError that names the field where a grid of a caller is none."""
    if not isinstance(grid, GridMap):
        raise MapError(f"{type(grid).__name__} is no GridMap: give GridMap(cells, resolution, origin)")
    cells, origin = grid.cells, np.asarray(grid.origin)
    if not isinstance(cells, np.ndarray) or cells.dtype != np.uint8 or cells.ndim != 2 or not cells.size:
        kind = getattr(cells, "dtype", type(cells).__name__)
        raise MapError(
            f"cells: {kind} of shape {np.shape(cells)}: give (H, W) uint8 of {FREE} free, "
            f"{OCCUPIED} occupied and {UNKNOWN} unknown"
        )
    others = np.setdiff1d(cells, (FREE, OCCUPIED, UNKNOWN))
    if len(others):
        raise MapError(
            f"cells: hold {others[0]}: give {FREE} free, {OCCUPIED} occupied and {UNKNOWN} unknown alone"
        )
    if not isinstance(grid.resolution, Real) or not FINEST_M <= grid.resolution <= COARSEST_M:
        raise MapError(f"resolution = {grid.resolution!r}: give metres a cell, such as 0.05")
    if origin.shape != (3,) or not _is_pose(origin.astype(np.float64).tolist()):
        raise MapError(f"origin = {grid.origin}: give x, y and yaw (3,), m, m, rad")


def read_map(path: Path) -> GridMap:
    """Reads the map of a map_server yaml (modes trinary, scale and raw).

    In a trinary image the savers' grey for unknown, 205, stays unknown for any free_thresh. Raises MapError
    that names the file, the field and the fix.
    """
    import yaml  # here: a projector reads no files, and is to be back soon after a crash

    if path.is_dir():
        raise MapError(f"{path}: is a folder: name the map_server yaml in it")
    try:
        meta = yaml.safe_load(_plain_yaml(path))
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}: check the path") from error
    except MapError:
        raise
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # no date, a number of 5,000 digits, ...
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f", line {mark.line + 1}"
        why = f" ({problem})" if (problem := getattr(error, "problem", "")) else ""  # such as a tab
        raise MapError(
            f"{path}{where}: is no map_server yaml{why}: give the yaml that names the image"
        ) from error
    if not isinstance(meta, dict):
        raise MapError(f"{path}: is no map_server yaml: expected image, resolution, origin")
    resolution = _number(path, meta, "resolution", None)
    if not FINEST_M <= resolution <= COARSEST_M:
        raise MapError(f"{path}: resolution = {resolution}: give metres per pixel, such as 0.05")
    given = meta.get("origin")
    if given is None:
        raise MapError(f"{path}: origin is missing: give [x, y, yaw] in metres and radians")
    origin = [_as_number(value) for value in given] if isinstance(given, list) else []
    if len(origin) != 3 or not _is_pose(origin):
        raise MapError(
            f"{path}: origin = {str(given)[:80]}: give [x, y, yaw] in metres and radians, "
            f"{FARTHEST_M:g} m and two turns at most"
        )
    if not isinstance(meta.get("image"), str):
        raise MapError(f"{path}: image is missing: name the pgm or png beside this file")
    cells, is_lossy = _cells(path, meta)
    pose = np.array(origin, dtype=np.float64)
    return GridMap(np.ascontiguousarray(cells[::-1]), resolution, pose, is_lossy=is_lossy)


def read_image(path: Path, metres_per_pixel: float) -> GridMap:
    """Map of an image alone, read as map_server reads it: black is occupied, white free, grey unknown.

    Its frame begins at the lower left corner. Raises MapError.
    """
    if not FINEST_M <= metres_per_pixel <= COARSEST_M:
        raise MapError(f"{path}: {metres_per_pixel} metres per pixel: give a scale such as 0.05")
    cells, is_lossy = _cells(path, {"image": path.name})
    return GridMap(np.ascontiguousarray(cells[::-1]), metres_per_pixel, np.zeros(3), is_lossy=is_lossy)


def _plain_yaml(path: Path) -> str:
    """The text of a map_server yaml. Raises MapError for hostile files and other files."""
    import yaml

    if path.exists() and not path.is_file():
        raise MapError(f"{path}: is no file that can be read to its end: give the map_server yaml")
    if path.stat().st_size > _MOST_YAML_BYTES:
        raise MapError(f"{path}: is too large for a map_server yaml: give the yaml that names the image")
    text = path.read_text(encoding="utf-8", errors="replace")  # a comment may have another encoding
    if nesting(text) > MOST_NESTED:
        raise MapError(f"{path}: is no map_server yaml: give the yaml that names the image")
    if any(isinstance(token, yaml.AliasToken) for token in yaml.scan(text)):  # a few of them fill the memory
        raise MapError(f"{path}: has a YAML alias (*name): write the value in its place")
    return text


def nesting(text: str) -> int:
    """How deep brackets and braces stand in each other: YAML's readers take a time of its square."""
    depth = most = 0
    for bracket in re.findall(r"[][{}]", text):
        depth += 1 if bracket in "[{" else -1
        most = max(most, depth)
    return most


def _number(path: Path, meta: dict[str, Any], name: str, default: float | None) -> float:
    given = meta.get(name, default)
    value = _as_number(given)
    if value is None or not abs(value) < 1e9:
        shown = "is missing" if given is None else f"= {given!r}"[:80]
        raise MapError(f"{path}: {name} {shown}: give a number")
    return value


def _share(path: Path, meta: dict[str, Any], name: str, default: float) -> float:
    value = _number(path, meta, name, default)
    if not 0.0 <= value <= 1.0:
        raise MapError(f"{path}: {name} = {value:g}: give a share, 0 to 1")
    return value


def _as_number(value: object) -> float | None:
    """A number of the yaml; 1e-17, which YAML 1.1 takes for a text, is one too."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        return float(value)
    except (ValueError, OverflowError):
        return None


def _is_pose(origin: Sequence[float | None]) -> bool:
    """Whether x, y and yaw are numbers that an origin may have, m, m, rad."""
    most = (FARTHEST_M, FARTHEST_M, _MOST_TURNED)
    return all(value is not None and abs(value) <= limit for value, limit in zip(origin, most, strict=True))


def _pixels(path: Path, file: Path) -> tuple[NDArray[np.uint8], bool]:
    """Pixels of the image of the map `path`: grey (H, W), or red, green, blue, alpha (H, W, 3 or 4).

    And whether it is a JPEG.
    """
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(file, formats=IMAGE_FORMATS) as image:
            held = max(SMALL_PIXELS, PIXELS_A_BYTE * file.stat().st_size)
            if image.width * image.height > min(MOST_CELLS, held):
                raise MapError(f"{path}: image {file} has {image.width} x {image.height} pixels: too large")
            if image.mode.startswith(("I", "F")):
                raise MapError(f"{path}: image {file} has more than 8 bits a pixel: save it with 8")
            is_lossy, has_alpha = image.format == "JPEG", "transparency" in image.info
            if image.mode in ("1", "L") and not has_alpha:
                return np.asarray(image.convert("L")), is_lossy
            has_alpha |= "A" in image.getbands()
            return np.asarray(image.convert("RGBA" if has_alpha else "RGB")), is_lossy
    except MapError:
        raise
    except FileNotFoundError as error:
        raise MapError(f"{path}: image {file} is missing: correct 'image', or put it there") from error
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, *_DAMAGE) as error:
        raise MapError(f"{path}: image {file} cannot be read: {error}: is it whole? Copy it again") from error


def _cells(path: Path, meta: dict[str, Any]) -> tuple[NDArray[np.uint8], bool]:
    """Cells of the image, first row at the top, and whether it is a JPEG."""
    file = path.parent / meta["image"]
    try:
        is_file = not file.exists() or file.is_file()
    except (OSError, ValueError) as error:
        raise MapError(f"{path}: image {str(file)[:200]!r} cannot be read: {error}") from error
    if not is_file:
        raise MapError(f"{path}: image {file} is no file: name the pgm or png beside this file")
    pixels, is_lossy = _pixels(path, file)
    # a table over all sums of red, green and blue, because there may be hundreds of millions of pixels
    sums = pixels if pixels.ndim == 2 else pixels[..., :3].sum(axis=-1, dtype=np.uint16)
    grey = np.arange(256.0) if pixels.ndim == 2 else np.arange(766.0) / 3.0
    transparent = pixels[..., 3] == 0 if pixels.ndim == 3 and pixels.shape[-1] == 4 else None
    mode = str(meta.get("mode", "trinary")).lower()  # as Nav2 reads it
    if mode not in ("trinary", "scale", "raw"):
        raise MapError(f"{path}: mode = {mode!r}: there are trinary, scale and raw")
    if mode == "raw":
        known = grey <= OCCUPIED
        occupied, free = known & (grey >= 50), known & (grey < 50)
    else:
        negate = meta.get("negate", 0)
        if negate not in (0, 1):
            raise MapError(f"{path}: negate = {negate!r}: give 0 or 1")
        above = _share(path, meta, "occupied_thresh", 0.65)
        below = _share(path, meta, "free_thresh", 0.196)
        if below > above:
            raise MapError(f"{path}: free_thresh = {below} is above occupied_thresh = {above}: swap them")
        occupancy = grey / 255.0 if negate else 1.0 - grey / 255.0
        occupied, free = occupancy > above, occupancy < below
        if mode == "trinary" and not negate and grey[int(sums.max(initial=0))] > _SAVED_UNKNOWN:
            free &= grey != _SAVED_UNKNOWN
    table = np.full(len(grey), UNKNOWN, dtype=np.uint8)
    table[free] = FREE
    table[occupied] = OCCUPIED
    cells: NDArray[np.uint8] = table[sums]
    if mode != "raw" and transparent is not None:  # paint programs leave what is unknown empty
        cells[transparent] = UNKNOWN
    for name, value in (("free", FREE), ("occupied", OCCUPIED)):
        if not np.any(cells == value):
            raise MapError(f"{path}: no {name} cell in {file}: check negate, free_thresh and occupied_thresh")
    return cells, is_lossy


def write_map(grid: GridMap, path: Path) -> None:
    """Writes `path` (yaml) and a pgm of the same name beside it, both whole or none. Raises OSError."""
    import yaml
    from PIL import Image

    grey = np.full(grid.cells.shape, _SAVED_UNKNOWN, dtype=np.uint8)
    grey[grid.cells == FREE] = 254
    grey[grid.cells == OCCUPIED] = 0
    path.parent.mkdir(parents=True, exist_ok=True)
    image = path.with_suffix(".pgm")
    meta = {
        "image": image.name,
        "resolution": float(grid.resolution),
        "origin": [float(v) for v in grid.origin],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    with whole(path) as text, whole(image) as picture:
        Image.fromarray(grey[::-1]).save(picture, format="PPM")
        text.write_text(yaml.safe_dump(meta, sort_keys=False), encoding="utf-8")


def to_message(grid: GridMap, frame_id: str) -> Grid:
    """foxglove.Grid with one uint8 field, `occupancy`."""
    width = grid.cells.shape[1]
    return Grid(
        frame_id=frame_id,
        pose=to_pose3(grid.origin),
        column_count=width,
        cell_size=Vector2(x=grid.resolution, y=grid.resolution),
        row_stride=width,
        cell_stride=1,
        fields=[PackedElementField(name=FIELD, offset=0, type=PackedElementField.UINT8)],
        data=grid.cells.tobytes(),
    )


def from_message(message: Grid) -> GridMap:
    """Inverse of to_message. Raises MapError if the grid has another form."""
    width = message.column_count
    ragged = not width or not message.data or len(message.data) % width
    if ragged or message.row_stride != width or message.cell_stride != 1:
        raise MapError(f"grid of {len(message.data)} bytes, {width} columns: expected one byte a cell")
    resolution = message.cell_size.x
    if not FINEST_M <= resolution <= COARSEST_M or resolution != message.cell_size.y:
        raise MapError(
            f"grid with cells of {resolution} x {message.cell_size.y} m: expected squares of {FINEST_M} to "
            f"{COARSEST_M} m"
        )
    if len(message.data) > MOST_CELLS:
        raise MapError(f"grid of {len(message.data)} cells: expected {MOST_CELLS} at most")
    cells = np.frombuffer(message.data, dtype=np.uint8).reshape(-1, width)
    origin = from_pose3(message.pose)
    if not (np.abs(origin) <= FARTHEST_M).all():
        raise MapError(
            f"grid whose origin is {origin.tolist()}: expected metres, {FARTHEST_M:g} at most, and a rotation"
        )
    return GridMap(cells, resolution, origin, is_received=True)
