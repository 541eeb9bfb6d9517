"""Makes one map of the scans of a whole log, without files or messages.

Chain (each scan aligned with the ones before), closures (the way returns to a place), visits (keyframes
aligned with other visits), one pose graph, and the occupancy by all rays.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import MOST_CELLS, GridMap
from eigenscan.geometry.pose import Array, between, compose, transform
from eigenscan.mapbuilder.mapping.bridges import bridge
from eigenscan.mapbuilder.mapping.chain import Chain, Chainer, Keyframe, Step, Sweep
from eigenscan.mapbuilder.mapping.closures import Closer, Closing
from eigenscan.mapbuilder.mapping.given_map import Located, corners, filled, frame_on, located_edges
from eigenscan.mapbuilder.mapping.pose_graph import Edge, check_installed, optimise
from eigenscan.mapbuilder.mapping.submap import Submap
from eigenscan.mapbuilder.mapping.visits import visit_edges
from numpy.typing import NDArray

Progress = Callable[[str, float], None]
"""Receives the step's name and the share of that step that is done."""

_CARVED_M, _CARVED_RAD = 0.05, np.deg2rad(2.0)
"""A scan is carved after this motion, m and rad, so a standing robot does not outvote a passing one."""
_STANDING = 50
"""Scans that are carved where the robot never moved: of one alone, most walls have too few rays."""


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
    sweeps: Sequence[Sweep],
    plan: Survey | None = None,
    progress: Progress = lambda _step, _share: None,
    located: Located | None = None,
) -> Mapped:
    """Map of scans in order of their stamps.

    With `located` scans, it is the given map made better: in its frame, and with its cells where no scan
    saw any. Raises MappingError, and MappingExtraError without gtsam.
    """
    plan = plan or Survey()
    check_installed()
    chain = _chained(sweeps, plan, progress)
    closer = _closed(chain.keyframes, sweeps, plan, progress)
    poses = _placed(chain.keyframes, closer)
    if located is None:
        kept = _largest(chain.keyframes, closer)
    else:
        kept = _put_on_map(chain.keyframes, poses, closer, located)
    poses[kept], edges, rejected = _sharpened(chain.keyframes, poses, kept, closer, plan, progress, located)
    inside = np.zeros(len(poses), dtype=np.bool_)
    inside[kept] = True
    joined = [place for place in chain.places if inside[place[1]]]
    numbers = np.array([number for number, _, _ in joined], dtype=np.int64)
    found = compose(poses[[frame for _, frame, _ in joined]], np.array([seen for _, _, seen in joined]))
    if located is None:
        found = between(found[0], found)
    grid = _carved(sweeps, numbers, found, plan.resolution, progress, located)
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


def _parts(keyframes: Sequence[Keyframe], closer: Closer) -> NDArray[np.int64]:
    """Number (K,) of the part that each keyframe is in."""
    part = np.zeros(len(keyframes), dtype=np.int64)
    for submap, number in zip(closer.submaps, closer.part, strict=True):
        part[submap.first : submap.last + 1] = number
    return part


def _largest(keyframes: Sequence[Keyframe], closer: Closer) -> NDArray[np.int64]:
    """Keyframes of the part that most of them are in."""
    part = _parts(keyframes, closer)
    return np.nonzero(part == np.bincount(part).argmax())[0]


def _put_on_map(
    keyframes: Sequence[Keyframe], poses: Array, closer: Closer, located: Located
) -> NDArray[np.int64]:
    """Keyframes of the parts that were located; moves their `poses` (K, 3) into the map frame."""
    part = _parts(keyframes, closer)
    edges = located_edges(keyframes, located, len(keyframes))
    kept = np.zeros(len(keyframes), dtype=np.bool_)
    for number in np.unique(part):
        inside = part == number
        frame = frame_on([edge for edge in edges if inside[edge.second]], poses)
        if frame is not None:
            poses[inside] = compose(frame, poses[inside])
            kept |= inside
    if not kept.any():
        raise MappingError("no stretch of the drive was located on the given map: check that it fits the log")
    return np.nonzero(kept)[0]


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
    located: Located | None,
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
    on_map = located_edges(frames, located, len(frames)) if located else []
    fit = np.ones(0, dtype=np.bool_)
    for number in range(plan.rounds):

        def compared(share: float, done: int = number) -> None:
            progress("comparing visits", (done + share) / plan.rounds)

        visits = visit_edges(frames, found, compared)
        nodes = np.vstack([found, np.zeros((1, 3))])  # the last one is the given map itself
        nodes, fit = optimise(nodes, [*edges, *visits, *on_map])
        found = between(nodes[-1], nodes[:-1])
    fit = fit[: len(fit) - len(on_map)]
    return found, int(np.count_nonzero(fit[steps:])), int(np.count_nonzero(~fit))


def _stretches(chain: Chain, inside: NDArray[np.bool_]) -> tuple[tuple[int, int], ...]:
    """First and last scan of each run of scans whose keyframe is not in the map."""
    outside = np.array([not inside[frame] for _, frame, _ in chain.places])
    numbers = np.array([number for number, _, _ in chain.places])
    edge = np.diff(np.concatenate([[0], outside.astype(np.int8), [0]]))
    starts, ends = np.nonzero(edge == 1)[0], np.nonzero(edge == -1)[0] - 1
    return tuple((int(numbers[a]), int(numbers[b])) for a, b in zip(starts, ends, strict=True))


def _carved(
    sweeps: Sequence[Sweep],
    numbers: NDArray[np.int64],
    poses: Array,
    resolution: float,
    progress: Progress,
    located: Located | None,
) -> GridMap:
    rays: list[tuple[Array, Array]] = []
    for k in _to_carve(sweeps, numbers, poses):
        sweep = sweeps[numbers[k]]
        sensor = compose(poses[k], sweep.mount)
        rays.append((sensor[:2], transform(sensor, sweep.outline.points)))
    seen = np.vstack([np.vstack([view, ends]) for view, ends in rays])
    inside = seen if located is None else np.vstack([seen, corners(located.grid)])
    check_extent(inside, resolution)
    carving = Carving.around(inside, resolution)
    for count, (view, ends) in enumerate(rays, 1):
        carving.add(view, ends)
        progress("carving the map", count / len(rays))
    return carving.to_map() if located is None else filled(carving.to_map(), located.grid)


def check_extent(points: Array, resolution: float) -> None:
    """Raises MappingError where points (K, 2), m, are too far apart for a map that can be read again."""
    wide, high = np.ptp(points, axis=0).tolist()
    if wide * high > MOST_CELLS * resolution**2:
        raise MappingError(
            f"its scans show walls {wide:.0f} m by {high:.0f} m apart: does the lidar mark beams without a "
            "return by a far range? State range_max in the log, or make the map coarser with --resolution"
        )


def _to_carve(sweeps: Sequence[Sweep], numbers: NDArray[np.int64], poses: Array) -> list[int]:
    """Places, among the placed scans, of those that are carved."""
    chosen: list[int] = []
    carved: dict[bytes, Array] = {}  # last carved pose of each lidar
    for k, (number, pose) in enumerate(zip(numbers, poses, strict=True)):
        lidar = sweeps[number].mount.tobytes()
        moved = between(carved[lidar], pose) if lidar in carved else None
        if moved is not None and np.hypot(*moved[:2]) < _CARVED_M and abs(moved[2]) < _CARVED_RAD:
            continue
        carved[lidar] = pose
        chosen.append(k)
    if len(chosen) == len(carved):  # each lidar's first
        few = min(len(numbers), _STANDING * len(carved))
        chosen = np.unique(np.linspace(0, len(numbers) - 1, few).astype(np.int64)).tolist()
    return chosen
