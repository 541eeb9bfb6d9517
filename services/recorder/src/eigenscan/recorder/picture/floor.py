"""The floor: the map, north up, and the outlines of the regions that have an eigenspace."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import rerun as rr
from eigenscan.geometry.gridmap import GridMap, MapError, from_message
from eigenscan.recorder.picture.canvas import Canvas
from eigenscan.recorder.picture.palette import REGION, TRUTH
from eigenscan.recorder.picture.shapes import is_place, lift
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import RegionModel
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from numpy.typing import NDArray

LABEL_M, LABEL_SHARE = 1.9, 0.035
"""m from a robot to its label, at least, and as a share of the map's height: its arrow is 1.4 m long."""
BAR_GAP = 0.04
"""Gap between the map and its scale bar, as a share of the map's height."""
BAR_SHARE = 0.2
"""Largest length of the scale bar, as a share of the map's width."""
BAR_STEPS_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0)
TEXTURE_CELLS = 4096
"""Longest side of a texture that every browser takes."""


class Floor:
    """Draws maps and regions; `extent`: the last map's corners as drawn: (low, high), each (2,), m."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self.extent: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._early: dict[str, Callable[[], None]] = {}
        """Draws again, by path, the outlines that came before a map."""

    def draw_map(self, received: Envelope) -> None:
        """The map as a texture at its scale. A grid of another form is left out."""
        try:
            grid = from_message(received.open(Grid))
        except MapError:
            return
        if not grid.cells.size or not is_place(grid.origin):
            return
        height, width = grid.cells.shape
        corners = grid.to_map([[0, 0], [width, 0], [0, height], [width, height]])
        if self.extent is None:  # what is drawn stays where it is, so the first map decides
            self._canvas.start_from(corners.min(axis=0))
        corners = self._canvas.local(corners)
        self.extent = corners.min(axis=0), corners.max(axis=0)
        while self._early:
            self._early.popitem()[1]()
        self._draw_scale(self.extent[0], self.extent[1])
        cells, resolution = _shrunk(grid)
        x, y, theta = self._canvas.local(grid.origin)
        self._canvas.fix(
            "world/map",
            rr.GridMap(
                data=cells[::-1].tobytes(),
                format=rr.components.ImageFormat(
                    width=cells.shape[1], height=cells.shape[0], color_model="L", channel_datatype="U8"
                ),
                cell_size=resolution,
                translation=[x, y, 0.0],
                rotation_axis_angle=rr.components.RotationAxisAngle([0, 0, 1], theta),
                colormap=rr.components.Colormap.RvizMap,
            ),
        )

    @property
    def label_gap(self) -> float:
        """Distance from a robot, m, at which its label does not cover its arrow."""
        return (
            LABEL_M if self.extent is None else max(LABEL_M, LABEL_SHARE * float(np.ptp(self.extent, 0)[1]))
        )

    def _draw_scale(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
        """A bar of a round length below the map's left corner."""
        width, height = high - low
        length = scale_length(float(width))
        x, y, tick = low[0], low[1] - BAR_GAP * height, 0.3 * BAR_GAP * height
        bar = lift([[x, y + tick], [x, y], [x + length, y], [x + length, y + tick]], 0.02)
        end = lift([[x + length, y]], 0.02)
        east, north = self._canvas.corner
        words = f"{length:g} m" + (f", x and y from ({east:.0f}, {north:.0f})" if east or north else "")
        self._canvas.fix(
            "world/scale",
            rr.LineStrips3D([bar], colors=[TRUTH], radii=rr.Radius.ui_points(2.0)),
            rr.Points3D(end, colors=[TRUTH], radii=0.0, labels=[words], show_labels=True),
        )

    def draw_region(self, received: Envelope) -> None:
        """The region's outline."""
        model = received.open(RegionModel)
        self.draw_outline(f"world/regions/{model.region}", model.outline_x, model.outline_y, 0.75)

    def draw_outline(
        self, path: str, x: Sequence[float], y: Sequence[float], width: float, label: str | None = None
    ) -> None:
        """A closed line through corners, map frame, m; `width` in points. A later map moves it."""
        corners = min(len(x), len(y))
        outline = np.column_stack([x[:corners], y[:corners]])
        if corners < 3:
            return
        if self.extent is None:  # the first map decides from where all is drawn
            own_x, own_y = outline.T.tolist()  # not the message's: it holds a whole model
            self._early[path] = partial(self.draw_outline, path, own_x, own_y, width, label)
        outline = self._canvas.local(outline)
        if not is_place(outline):
            return
        self._canvas.fix(
            path,
            rr.LineStrips3D(
                [lift(np.concatenate([outline, outline[:1]]), 0.01)],
                colors=[REGION],
                labels=None if label is None else [label],
                radii=rr.Radius.ui_points(width),
            ),
        )


def scale_length(width: float) -> float:
    """The longest round length, m, that takes at most BAR_SHARE of `width`, m."""
    return max((step for step in BAR_STEPS_M if step <= BAR_SHARE * width), default=BAR_STEPS_M[0])


def _shrunk(grid: GridMap) -> tuple[NDArray[np.uint8], float]:
    """Cells and resolution, coarser by a whole factor if the map is too big for a texture; walls stay."""
    factor = -(-max(grid.cells.shape) // TEXTURE_CELLS)
    if factor == 1:
        return grid.cells, grid.resolution
    height, width = grid.cells.shape
    padded = np.pad(grid.cells, ((0, -height % factor), (0, -width % factor)), constant_values=255)
    blocks = padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)
    # 255 (unknown) must not outweigh a wall: as a signed byte it is -1
    coarse = blocks.view(np.int8).max(axis=(1, 3)).view(np.uint8)
    return coarse, grid.resolution * factor
