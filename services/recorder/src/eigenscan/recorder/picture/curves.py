"""Scans as curves over the bearing: the scan, its reconstruction, and the eigen-scans.

Bearings go from right to left as the robot sees them, so a wall on the left is on the left. A 2-D view of
Rerun counts y downwards.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas
from eigenscan.recorder.picture.manifold import Manifold
from eigenscan.recorder.picture.palette import HYPOTHESIS, PLACE, SCAN, TRACK
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import NDArray

Array32 = NDArray[np.float32]

HALF_WIDTH = 10.0
"""Width of the curves: half the field of view."""
LABEL_WIDTH = 6.0
SCAN_HEIGHT, EIGENSCAN_HEIGHT = 5.0, 2.0
EIGENSCANS_DRAWN = 5
BOUNDS = (
    (-HALF_WIDTH - 0.5, HALF_WIDTH + LABEL_WIDTH),
    (-SCAN_HEIGHT - 0.5, EIGENSCANS_DRAWN * EIGENSCAN_HEIGHT + 0.5),
)
"""Visible area: x from, to; y from (top), to."""


def draw_scan(
    canvas: Canvas, stamp: int, path: str, manifold: Manifold, scan: Scan, alpha: Sequence[float]
) -> None:
    """The scan's ranges, and its reconstruction from its coefficients `alpha` (M,) (paper, eq. 3)."""
    bearings, seen = manifold.bearings(scan), manifold.seen(scan)
    again = manifold.kept(alpha, seen)
    for name, values, style in (("kept", again, _kept_style), ("seen", seen, _seen_style)):
        canvas.style(f"{path}/{name}", style)
        height = -np.minimum(values, manifold.far) * np.float32(SCAN_HEIGHT / manifold.far)
        canvas.draw(stamp, f"{path}/{name}", rr.LineStrips2D(_unbroken(bearings, height)))


def draw_eigenscans(canvas: Canvas, stamp: int, path: str, manifold: Manifold, scan: Scan) -> None:
    """The first eigenvectors below each other, a line a channel, with their shares of the variance."""
    bearings = manifold.bearings(scan)
    vectors, shares = manifold.eigenscans(EIGENSCANS_DRAWN)
    middles = EIGENSCAN_HEIGHT * (np.arange(len(vectors)) + 0.5)
    largest = max(float(np.abs(vectors).max(initial=0.0)), 1e-9)
    heights = middles[:, None, None] - vectors * (0.45 * EIGENSCAN_HEIGHT / largest)
    strips = [_curve(bearings, height) for vector in heights for height in vector]
    colours = [colour for vector in heights for colour in (TRACK, HYPOTHESIS)[: len(vector)]]
    zeros = [np.array([[-HALF_WIDTH, y], [HALF_WIDTH, y]]) for y in middles]
    labels = [f"{n + 1}: {share:.0%} of the variance" for n, share in enumerate(shares)]
    canvas.style(f"{path}/zero", _zero_style)
    canvas.draw(stamp, f"{path}/zero", rr.LineStrips2D(zeros))
    canvas.style(path, _eigenscan_style)
    beside = np.column_stack([np.full(len(middles), HALF_WIDTH + 0.5 * LABEL_WIDTH), middles])
    canvas.draw(stamp, path, rr.LineStrips2D(strips, colors=colours), rr.Points2D(beside, labels=labels))


def _curve(bearings: Array32, height: Array32) -> Array32:
    return np.column_stack([-bearings * (np.float32(HALF_WIDTH) / np.abs(bearings).max()), height])


def _unbroken(bearings: Array32, height: Array32) -> list[Array32]:
    """The stretches of a curve between its gaps (NaN)."""
    points = _curve(bearings, height)
    there = np.flatnonzero(np.isfinite(height))
    stretches = np.split(there, np.flatnonzero(np.diff(there) > 1) + 1)
    return [points[stretch] for stretch in stretches if len(stretch) > 1]


def _seen_style() -> tuple[rr.LineStrips2D]:
    return (rr.LineStrips2D.from_fields(colors=[SCAN], radii=rr.Radius.ui_points(1.5)),)


def _kept_style() -> tuple[rr.LineStrips2D]:
    return (rr.LineStrips2D.from_fields(colors=[HYPOTHESIS], radii=rr.Radius.ui_points(1.5)),)


def _eigenscan_style() -> tuple[rr.LineStrips2D, rr.Points2D]:
    return (
        rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5)),
        rr.Points2D.from_fields(colors=[TRACK], radii=rr.Radius.ui_points(0.0), show_labels=True),
    )


def _zero_style() -> tuple[rr.LineStrips2D]:
    return (rr.LineStrips2D.from_fields(colors=[PLACE], radii=rr.Radius.ui_points(0.75)),)
