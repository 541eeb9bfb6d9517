"""Makes one map of the scans of a whole log, without files or messages.

Chain (each scan aligned with the ones before), closures (the way returns to a place), visits (keyframes
aligned with other visits), one pose graph, and the occupancy by all rays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.pose import Array, between, compose, transform
from eigenscan.mapbuilder.mapping.bridges import bridge
from eigenscan.mapbuilder.mapping.chain import Chain, Chainer, Keyframe, Step, Sweep
from eigenscan.mapbuilder.mapping.closures import Closer, Closing
from eigenscan.mapbuilder.mapping.pose_graph import Edge, check_installed, optimise
from eigenscan.mapbuilder.mapping.submap import Submap
from eigenscan.mapbuilder.mapping.visits import visit_edges
from numpy.typing import NDArray

Progress = Callable[[str, float], None]
"""Receives the step's name and the share of that step that is done."""

_CARVED_M, _CARVED_RAD = 0.05, np.deg2rad(2.0)
"""A scan is carved after this motion, m and rad, so a standing robot does not outvote a passing one."""


class MappingError(ValueError):
    """Scans that cannot make a map; the message has the reason and the fix."""


@dataclass(frozen=True)
class Survey:
    """How a log becomes a map. Lengths in m, angles in rad."""

    resolution: float = 0.05
    core: int = 12
    """Keyframes of a submap."""
    around: int = 6
    """Number of keyframes before and after whose walls it uses."""
    rounds: int = 2
    """Times that visits are compared and the graph is optimised."""
    step: Step = field(default_factory=Step)
    closing: Closing = field(default_factory=Closing)


@dataclass(frozen=True)
class Mapped:
    """A map and the way through it.

    `numbers` (n,): the scans that were placed; `poses` (n, 3): of the base, in the frame of the first one.
    `unjoined`: first and last scan of each stretch that could not be joined to the rest.
    """

    grid: GridMap
    numbers: NDArray[np.int64]
    poses: Array
    unjoined: tuple[tuple[int, int], ...]
    left_out: int
    jumps: int
    keyframes: int
    closures: int
    rejected: int

    @property
    def way(self) -> float:
        """Length of the way, m, in steps of at least 5 cm."""
        kept = [0]
        for k in range(1, len(self.poses)):  # each step decides the start of the next one
            if np.hypot(*(self.poses[k, :2] - self.poses[kept[-1], :2])) >= _CARVED_M:
                kept.append(k)
        return float(np.linalg.norm(np.diff(self.poses[kept, :2], axis=0), axis=1).sum())


def survey(
    sweeps: Sequence[Sweep], plan: Survey | None = None, progress: Progress = lambda _step, _share: None
) -> Mapped:
    """Map of scans in order of their stamps. Raises MappingError, and MappingExtraError without gtsam."""
    plan = plan or Survey()
    check_installed()
    chain = _chained(sweeps, plan, progress)
    closer = _closed(chain.keyframes, sweeps, plan, progress)
    kept = _largest(chain.keyframes, closer)
    poses = _placed(chain.keyframes, closer)
    poses[kept], edges, rejected = _sharpened(chain.keyframes, poses, kept, closer, plan, progress)
    inside = np.zeros(len(poses), dtype=np.bool_)
    inside[kept] = True
    joined = [place for place in chain.places if inside[place[1]]]
    numbers = np.array([number for number, _, _ in joined], dtype=np.int64)
    found = compose(poses[[frame for _, frame, _ in joined]], np.array([seen for _, _, seen in joined]))
    found = between(found[0], found)
    grid = _carved(sweeps, numbers, found, plan.resolution, progress)
    return Mapped(
        grid,
        numbers,
        found,
        _stretches(chain, inside),
        left_out=chain.left_out,
        jumps=chain.jumps,
        keyframes=len(kept),
        closures=edges,
        rejected=rejected,
    )


def _chained(sweeps: Sequence[Sweep], plan: Survey, progress: Progress) -> Chain:
    chainer = Chainer(plan.step)
    for number, sweep in enumerate(sweeps):
        chainer.add(number, sweep)
        progress("aligning scans", (number + 1) / len(sweeps))
    if len(chainer.chain.places) < 2:
        raise MappingError(
            f"{len(chainer.chain.places)} of {len(sweeps)} scans show walls "
            f"(at least {plan.step.least_points} points): a map needs two or more"
        )
    return chainer.chain


def _closed(
    keyframes: Sequence[Keyframe], sweeps: Sequence[Sweep], plan: Survey, progress: Progress
) -> Closer:
    closer = Closer(keyframes, plan.closing)
    parts = np.array([frame.part for frame in keyframes])
    for part in np.unique(parts):
        first, last = np.nonzero(parts == part)[0][[0, -1]].tolist()
        for start in range(first, last + 1, plan.core):
            end = min(start + plan.core, last + 1)
            around = range(max(start - plan.around, first), min(end + plan.around, last + 1))
            closer.add(Submap.of(keyframes, sweeps, range(start, end), around))
            progress("closing loops", 0.9 * end / len(keyframes))
    bridge(closer)
    closer.again()
    progress("closing loops", 1.0)
    return closer


def _largest(keyframes: Sequence[Keyframe], closer: Closer) -> NDArray[np.int64]:
    """Keyframes of the part that most of them are in."""
    part = np.zeros(len(keyframes), dtype=np.int64)
    for submap, number in zip(closer.submaps, closer.part, strict=True):
        part[submap.first : submap.last + 1] = number
    return np.nonzero(part == np.bincount(part).argmax())[0]


def _placed(keyframes: Sequence[Keyframe], closer: Closer) -> Array:
    """Poses (K, 3) of the keyframes on their submaps."""
    poses = np.array([frame.pose for frame in keyframes])
    for submap, pose in zip(closer.submaps, closer.poses, strict=True):
        own = slice(submap.first, submap.last + 1)
        poses[own] = compose(pose, between(keyframes[submap.anchor].pose, poses[own]))
    return poses


def _sharpened(
    keyframes: Sequence[Keyframe],
    poses: Array,
    kept: NDArray[np.int64],
    closer: Closer,
    plan: Survey,
    progress: Progress,
) -> tuple[Array, int, int]:
    """Poses of the kept keyframes by the whole graph, how many edges close loops, how many it rejected."""
    frames, found = [keyframes[k] for k in kept], poses[kept]
    place = {int(k): n for n, k in enumerate(kept)}
    edges = [
        Edge(n - 1, n, between(frames[n - 1].pose, frame.pose), frame.covariance, trusted=True)
        for n, frame in enumerate(frames)
        if frame.covariance is not None
    ]
    steps = len(edges)
    anchors = [submap.anchor for submap in closer.submaps]
    edges += [
        Edge(place[anchors[edge.first]], place[anchors[edge.second]], edge.pose, edge.covariance)
        for edge in closer.edges
        if not edge.trusted and anchors[edge.first] in place and anchors[edge.second] in place
    ]
    fit = np.ones(0, dtype=np.bool_)
    for number in range(plan.rounds):

        def compared(share: float, done: int = number) -> None:
            progress("comparing visits", (done + share) / plan.rounds)

        visits = visit_edges(frames, found, compared)
        found, fit = optimise(found, [*edges, *visits])
    return found, int(np.count_nonzero(fit[steps:])), int(np.count_nonzero(~fit))


def _stretches(chain: Chain, inside: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """First and last scan of each run of scans whose keyframe is not in the map."""
    outside = np.array([not inside[frame] for _, frame, _ in chain.places])
    numbers = np.array([number for number, _, _ in chain.places])
    edge = np.diff(np.concatenate([[0], outside.astype(np.int8), [0]]))
    starts, ends = np.nonzero(edge == 1)[0], np.nonzero(edge == -1)[0] - 1
    return tuple((int(numbers[a]), int(numbers[b])) for a, b in zip(starts, ends, strict=True))


def _carved(
    sweeps: Sequence[Sweep], numbers: NDArray[np.int64], poses: Array, resolution: float, progress: Progress
) -> GridMap:
    rays: list[tuple[Array, Array]] = []
    carved: dict[bytes, Array] = {}  # last carved pose of each lidar
    for number, pose in zip(numbers, poses, strict=True):
        sweep = sweeps[number]
        last = carved.get(sweep.mount.tobytes())
        moved = None if last is None else between(last, pose)
        if moved is not None and np.hypot(*moved[:2]) < _CARVED_M and abs(moved[2]) < _CARVED_RAD:
            continue
        carved[sweep.mount.tobytes()] = pose
        sensor = compose(pose, sweep.mount)
        rays.append((sensor[:2], transform(sensor, sweep.outline.points)))
    carving = Carving.around(np.vstack([np.vstack([view, ends]) for view, ends in rays]), resolution)
    for count, (view, ends) in enumerate(rays, 1):
        carving.add(view, ends)
        progress("carving the map", count / len(rays))
    return carving.to_map()
