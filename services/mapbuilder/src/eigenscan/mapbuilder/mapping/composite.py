"""A few scans at unknown poses, in no order, become one frame and one map (paper, section 3, figure 2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import Array, compose, inverse, transform
from eigenscan.mapbuilder.mapping.alignment import FINE, align
from eigenscan.mapbuilder.mapping.bridges import ANYWHERE, STRICT
from eigenscan.mapbuilder.mapping.chain import Keyframe, Sweep
from eigenscan.mapbuilder.mapping.closures import Closer, Match
from eigenscan.mapbuilder.mapping.cloud import Cloud
from eigenscan.mapbuilder.mapping.submap import Submap
from eigenscan.mapbuilder.mapping.survey import Mapped, MappingError, Progress
from skimage.draw import polygon

_LONGEST_GAP = np.deg2rad(3.0)
"""Between two beams of which something is known of the space between them."""
_LEAST_POINTS = 20
"""A scan with fewer joins none."""


def composite(
    sweeps: Sequence[Sweep],
    resolution: float = 0.05,
    progress: Progress = lambda _step, _share: None,
) -> Mapped:
    """Map of scans without poses, `resolution` in m per cell.

    Every pair is matched without a prior, like submaps of two parts. The surest pairs join first, to the part
    of the first scan. Raises MappingError if no two scans join.
    """
    numbers = [k for k, sweep in enumerate(sweeps) if len(sweep.outline.ranges) >= _LEAST_POINTS]
    frames = [
        Keyframe(k, k, np.zeros(3), Cloud.of(sweeps[k].outline, sweeps[k].mount), None) for k in numbers
    ]
    closer = Closer(frames)
    closer.submaps = [Submap.of(frames, sweeps, range(n, n + 1), range(n, n + 1)) for n in range(len(frames))]
    pairs: list[tuple[int, int, Match]] = []
    for one in range(len(frames)):
        for other in range(one + 1, len(frames)):
            match = closer.match(one, other, np.zeros(3), ANYWHERE, STRICT)
            if match is not None:
                pairs.append((one, other, match))
        progress("joining scans", (one + 1) / len(frames))
    poses = np.full((len(frames), 3), np.nan)
    poses[:1] = 0.0
    pairs.sort(key=lambda pair: -pair[2].net)
    while reachable := [p for p in pairs if np.isnan(poses[p[0], 0]) != np.isnan(poses[p[1], 0])]:
        one, other, match = reachable[0]
        step = align(frames[one].cloud, frames[other].cloud, match.pose, reaches=FINE).pose
        if np.isnan(poses[other, 0]):
            poses[other] = compose(poses[one], step)
        else:
            poses[one] = compose(poses[other], inverse(step))
    joined = np.nonzero(np.isfinite(poses[:, 0]))[0]
    if len(joined) < 2:
        raise MappingError(f"no two of {len(sweeps)} scans could be joined: they need to overlap")
    placed = np.array([numbers[k] for k in joined], dtype=np.int64)
    return Mapped(
        _drawn([sweeps[k] for k in placed], poses[joined], resolution),
        placed,
        poses[joined],
        unjoined=tuple((k, k) for k in numbers if k not in placed),
        left_out=len(sweeps) - len(numbers),
        jumps=0,
        keyframes=len(joined),
        closures=len(pairs),
        rejected=0,
    )


def _drawn(sweeps: Sequence[Sweep], poses: Array, resolution: float) -> GridMap:
    """Free cells between and along beams; occupied cells at their ends."""
    sensors = [compose(pose, sweep.mount) for sweep, pose in zip(sweeps, poses, strict=True)]
    points = [transform(at, sweep.outline.points) for sweep, at in zip(sweeps, sensors, strict=True)]
    reach = np.vstack([*points, *(at[None, :2] for at in sensors)])
    low = np.floor(reach.min(axis=0) / resolution) - 2
    shape = (np.ceil(reach.max(axis=0) / resolution) - low + 3).astype(np.int64)[::-1]
    cells = np.full(shape, UNKNOWN, dtype=np.uint8)
    for sweep, at, ends in zip(sweeps, sensors, points, strict=True):
        breaks = np.nonzero(np.diff(sweep.outline.bearings) > _LONGEST_GAP)[0] + 1
        for part in np.split(ends, breaks):
            corners = np.vstack([at[None, :2], part]) / resolution - low
            rows, columns = polygon(corners[:, 1], corners[:, 0], cells.shape)
            cells[rows, columns] = FREE
    column, row = (np.floor(np.vstack(points) / resolution) - low).astype(np.int64).T
    cells[row, column] = OCCUPIED
    return GridMap(cells, resolution, np.array([*(low * resolution), 0.0]))
