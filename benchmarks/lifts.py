"""Rides in a lift over stacked maps: how soon the floor is right, and how often a wrong one is claimed.

    .venv/bin/python benchmarks/lifts.py [--rides 100] [--first 0] [--kind unlike] [--json OUT]
    .venv/bin/python benchmarks/lifts.py --maps intel/map.yaml fr079/map.yaml [--rides 100]

A robot drives 2.5 m to the cabin, turns around in it while it sees its walls alone, and drives out on another
floor, through scan-ingest, projector and tracker as they are on a robot. A ride ends once the robot was right
for half a second, or 2.5 m out. Where the robot may get out anywhere, ten rides share their way in.

Kinds of stack: `unlike` (two floors with nothing in common), `refurnished` (one plan twice, each with half of
its furniture; the lift is at the same place) and `alike` (one and the same floor twice). With `--maps` the
floors are real maps of one cell size. A ride counts if a pose was claimed on the first floor; on floors that
are alike none must be. Floors differ for a ride if in its first second more beams see another range than
people hide: on the floor that was left, where the lift is at the same place, else at the likeliest other
places that a scan brings up.
"""

from __future__ import annotations

import argparse
import copy
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.floors import floor_of
from eigenscan.geometry.gridmap import GridMap, read_map, to_message
from eigenscan.geometry.pose import compose, from_message, to_pose3
from eigenscan.geometry.raycast import RayCaster
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import announce_models
from eigenscan.mapbuilder.floors import name_by_floor, stack
from eigenscan.mapbuilder.site import Plan, build_site, lay_out
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL_SET, ODOMETRY, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.world import office
from floors import floor, poses
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

Array = NDArray[np.float64]

ADDRESS = {"site": "s", "robot": "r", "lidar": "front"}
RATE_HZ, STEP_M = 10, 0.1
WAY_M, TURN_SCANS = 2.5, 25
"""To the cabin and out of it; scans in it."""
CABIN_M = 0.8
"""Half a cabin's width."""
BEAMS, FIELD_RAD, REACH_M, NOISE_M, PEOPLE = 541, np.radians(270.0), 25.0, 0.01, 0.05
BEARINGS = np.linspace(-0.5 * FIELD_RAD, 0.5 * FIELD_RAD, BEAMS)
ROOM_M = 0.5
"""More than the way that must be free ahead."""
INSIDE = 0.5
"""Of the beams that end within reach, at least: real maps also have free cells outside of the walls."""
RIGHT_M = 0.5
SOON_S = 1.0
DIFFER_M = 0.3
"""Ranges that differ by more show which floor it is: six cells of a map."""
RIVALS = 5
"""Other places, the likeliest first, that are compared with the right one."""
SHARES = (0.01, 0.02, PEOPLE, 0.1, 0.2)
"""Of the beams that differ: the summary's rows end at these."""
HELD = 5
"""Right poses in a row after which a ride ends."""
EXITS = 10
"""Rides that share one way in, where the robot may get out anywhere."""
EVERY = 250
"""Rides between two lines, so that what was done so far is known."""


@dataclass(frozen=True)
class Ride:
    """What was claimed of the floor after the doors opened; times and ways since then."""

    number: int
    claimed_before: bool
    right_after_s: float | None
    """From when on a pose on the right floor was claimed."""
    wrong_floor_m: float
    """Driven while a wrong floor was claimed."""
    wrong_floor_scans: int
    wrong_place_scans: int
    claimed_scans: int
    differs: float = 1.0
    """Of the beams of the first second, how many see another range at the place most alike."""
    nearer: float = 1.0
    """Of these beams, how many end nearer than they would there: at things that its map lacks."""


@dataclass
class Building:
    """Floors by name, and a projector that knows them."""

    floors: dict[str, GridMap]
    same_place: bool

    def __post_init__(self) -> None:
        grid, floors = stack(list(self.floors.items()))
        plan = Plan()
        built = build_site(grid, plan, layout=name_by_floor(lay_out(grid, plan), floors))
        site = replace(built, floors=floors)
        self.parts = {each.name: each for each in floors}
        self.casters = {name: RayCaster.of(own) for name, own in self.floors.items()}
        self.models = list(announce_models(site, "s"))
        self.projector = ProjectorCore(ProjectorSettings())
        for published in (Envelope(MAP, {"site": "s"}, to_message(grid, site.frame_id)), *self.models):
            self.projector.handle(published)

    def rides(self, numbers: Sequence[int]) -> Iterator[Ride]:
        """Rides, each always the same by its number."""
        exits = 1 if self.same_place else EXITS
        for way, own in groupby(numbers, lambda number: number // exits):
            rng = np.random.default_rng(way)
            begin, end = self._names(rng)
            into = self._exit(begin, rng, end if self.same_place else None)
            robot, claimed = self._ride_in(begin, into, rng)
            for number in own:
                rng = np.random.default_rng([way, number])
                left = [name for name in self.floors if name != begin]
                floor = end if self.same_place else left[int(rng.integers(len(left)))]
                out = into if self.same_place else self._exit(floor, rng)
                again = robot.again(rng)
                ride = _ride(number, claimed, self._ride_out(again, floor, out))
                others = [(begin, out)] if self.same_place else self._others(again, floor, out)
                shares = [self._differ(other, place, floor, out) for other, place in others]
                differs, nearer = min(shares, default=(1.0, 1.0))
                yield replace(ride, differs=differs, nearer=nearer)

    def _names(self, rng: np.random.Generator) -> tuple[str, str]:
        names = list(self.floors)
        begin, end = (names[i] for i in rng.permutation(len(names))[:2])
        return begin, end

    def _ride_in(self, begin: str, into: Array, rng: np.random.Generator) -> tuple[_Robot, bool]:
        """A robot that drove to the cabin and turned around in it, and whether it claimed a pose before."""
        tracker = TrackerCore(TrackerSettings())
        for published in self.models:
            if published.channel == MODEL_SET:
                tracker.handle(published)
        robot = _Robot(ScanIngestCore(ScanIngestSettings()), self.projector, tracker, rng)
        before: list[PoseEstimate] = []
        for ahead in np.arange(WAY_M, STEP_M, -STEP_M):
            at = compose(compose(into, [ahead, 0.0, 0.0]), [0.0, 0.0, np.pi])
            before += robot.see(self._scan(begin, at), [STEP_M, 0.0, 0.0])
        for turned in np.linspace(-np.pi, 0.0, TURN_SCANS):
            square = CABIN_M / np.maximum(
                np.abs(np.cos(BEARINGS + turned)), np.abs(np.sin(BEARINGS + turned))
            )
            robot.see(square, [0.0, 0.0, np.pi / (TURN_SCANS - 1)])
        return robot, any(one.state == STATE_LOCALIZED for one in before[-5:])

    def _ride_out(self, robot: _Robot, end: str, out: Array) -> list[tuple[int, list[str]]]:
        """What each pose on the way out is worth, by step."""
        after: list[tuple[int, list[str]]] = []
        for step in range(round(WAY_M / STEP_M)):
            at = compose(out, [STEP_M * step, 0.0, 0.0])
            seen = robot.see(self._scan(end, at), [STEP_M, 0.0, 0.0])
            after.append((step, [self._judge(end, at, one) for one in seen]))
            if len(after) >= HELD and all("right" in worth for _, worth in after[-HELD:]):
                break
        return after

    def _others(self, robot: _Robot, end: str, out: Array) -> list[tuple[str, Array]]:
        """The likeliest other places of the robot's last list, each with its floor, as seen from the lift."""
        found = list[tuple[str, Array]]()
        right = compose(out, [robot.way, 0.0, 0.0])
        for one in robot.listed:
            on = floor_of(self.parts.values(), one)
            own = None if on is None else on.own(one)
            if on is None or own is None or (on.name == end and np.hypot(*(own - right)[:2]) <= RIGHT_M):
                continue
            found.append((on.name, compose(own, [-robot.way, 0.0, 0.0])))
        return found[:RIVALS]

    def _differ(self, other: str, place: Array, end: str, out: Array) -> tuple[float, float]:
        """Shares of the beams that differ between two places, and that end nearer, over the first second."""
        ways = np.linspace(0.0, SOON_S * RATE_HZ * STEP_M, 3)
        there, here = (
            np.array([self._scan(name, compose(pose, [way, 0.0, 0.0])) for way in ways])
            for name, pose in ((other, place), (end, out))
        )
        nearer = there.clip(max=REACH_M) - here.clip(max=REACH_M)
        return float(np.mean(np.abs(nearer) > DIFFER_M)), float(np.mean(nearer > DIFFER_M))

    def _exit(self, name: str, rng: np.random.Generator, other: str | None = None) -> Array:
        """A pose (3,) in a floor's own frame with a free way ahead; on floor `other` too."""
        for pose in poses(self.floors[name], 400, int(rng.integers(1 << 30)), clearance=0.4):
            if all(self._clear(each, pose) for each in (name, other) if each):
                return np.asarray(pose)
        raise SystemExit(f"{name}: nowhere a free way of {WAY_M} m")

    def _clear(self, name: str, pose: Array) -> bool:
        fan = np.radians([-8.0, 0.0, 8.0])
        if self.casters[name].cast(pose, fan, REACH_M)[0].min() <= WAY_M + ROOM_M:
            return False
        ends = [self._scan(name, compose(pose, [ahead, 0.0, 0.0])) for ahead in (0.0, WAY_M)]
        return bool(np.min(np.mean(np.array(ends) < REACH_M, axis=1)) >= INSIDE)

    def _scan(self, name: str, pose: Array) -> Array:
        return np.asarray(self.casters[name].cast(pose, BEARINGS, REACH_M)[0], dtype=np.float64)

    def _judge(self, name: str, truth: Array, estimate: PoseEstimate) -> str:
        """What a pose is worth: "", "right", "wrong place" or "wrong floor"."""
        if estimate.state != STATE_LOCALIZED:
            return ""
        pose = from_message(estimate.pose)
        on = floor_of(self.parts.values(), pose)
        if on is None or on.name != name or estimate.floor != name:
            return "wrong floor"
        off = from_message(estimate.floor_pose) - truth
        return "right" if np.hypot(off[0], off[1]) <= RIGHT_M else "wrong place"


class _Robot:
    """Gives scans and odometry to the pipeline; odometry drifts by 2 % and 1 degree a metre."""

    def __init__(
        self, ingest: ScanIngestCore, projector: ProjectorCore, tracker: TrackerCore, rng: np.random.Generator
    ) -> None:
        self._projector, self._rng = projector, rng
        self._loop = Loopback([ingest, projector, tracker])
        self._odometry, self._at = np.zeros(3), 1_000_000_000
        self.way, self.listed = 0.0, list[Array]()
        """Driven since it was copied; the poses of the last list, the likeliest first."""
        self._loop.start()

    def again(self, rng: np.random.Generator) -> _Robot:
        """A second robot with the same past. The projector knows maps alone, so both share it."""
        other = copy.deepcopy(self, {id(self._projector): self._projector})
        other._rng, other.way, other.listed = rng, -STEP_M, []
        return other

    def see(self, ranges: Array, step: Sequence[float]) -> list[PoseEstimate]:
        """Poses that follow from one scan, taken after the robot moved by `step` (3,)."""
        self._at += 1_000_000_000 // RATE_HZ
        moved = np.asarray(step) * [1.02, 1.0, 1.0]
        self._odometry = compose(self._odometry, moved + np.array([0.0, 0.0, self._rng.normal(0.0, 0.005)]))
        odometry = Odometry(timestamp=stamp(self._at), pose=to_pose3(self._odometry))
        published = self._loop.receive(Envelope(ODOMETRY, ADDRESS, odometry))
        published += self._loop.receive(Envelope(SCAN_RAW, ADDRESS, self._raw(ranges)))
        self.way += step[0]
        for one in published:
            if one.channel == HYPOTHESES:
                self.listed = [from_message(each.pose) for each in one.open(Hypotheses).hypotheses]
        return [one.open(PoseEstimate) for one in published if one.channel == POSE]

    def _raw(self, ranges: Array) -> RawScan:
        seen = ranges + self._rng.normal(0.0, NOISE_M, BEAMS)
        hidden = 0
        while hidden < PEOPLE * BEAMS:
            away, begin = self._rng.uniform(0.6, 3.0), int(self._rng.integers(BEAMS))
            legs = slice(begin, begin + max(1, round(0.15 / away / (BEARINGS[1] - BEARINGS[0]))))
            seen[legs] = np.minimum(seen[legs], away)
            hidden += legs.stop - legs.start
        return RawScan(
            timestamp=stamp(self._at),
            angle_min=BEARINGS[0],
            angle_increment=BEARINGS[1] - BEARINGS[0],
            range_min=0.05,
            range_max=REACH_M,
            ranges=np.maximum(seen, 0.05).tolist(),
        )


def _ride(number: int, claimed_before: bool, after: list[tuple[int, list[str]]]) -> Ride:
    verdicts = [(step, one) for step, each in after for one in each]
    wrong = [step for step, one in verdicts if one == "wrong floor"]
    right = [step for step, one in verdicts if one == "right"]
    last_wrong = max(wrong, default=-1)
    since = next((step for step in right if step > last_wrong), None)
    return Ride(
        number,
        claimed_before,
        None if since is None else since / RATE_HZ,
        (last_wrong + 1) * STEP_M,
        len(wrong),
        sum(one == "wrong place" for _, one in verdicts),
        sum(one != "" for _, one in verdicts),
    )


def buildings(kind: str) -> Building:
    """The stack of a kind."""
    if kind == "unlike":
        return Building({"ground": floor(300.0, seed=5), "first": floor(300.0, seed=6)}, same_place=False)
    plan = office()
    pieces = plan.furniture
    if kind == "refurnished":
        first, second = (replace(plan, furniture=tuple(pieces[i::2])) for i in range(2))
        return Building({"ground": first.render(), "first": second.render()}, same_place=True)
    return Building({"ground": plan.render(), "first": plan.render()}, same_place=True)


def real(paths: Sequence[Path]) -> Building:
    """Real maps, one floor each."""
    return Building({path.parent.name or path.stem: read_map(path) for path in paths}, same_place=False)


def summary(kind: str, rides: Sequence[Ride]) -> dict[str, Any]:
    """Shares of the rides that count."""
    counted = [one for one in rides if one.claimed_before] if kind != "alike" else list(rides)
    differ = [one for one in counted if one.differs > PEOPLE]
    wrong = [one for one in counted if one.wrong_floor_scans]
    ways = Counter(round(one.wrong_floor_m, 1) for one in wrong)
    return {
        "kind": kind,
        "rides": len(rides),
        "counted": len(counted),
        "right_within_1s": _soon(counted),
        "floors_differ": len(differ),
        "right_within_1s_where_they_differ": _soon(differ),
        "by_share_of_beams_that_differ": _by_share(counted, [one.differs for one in counted]),
        "by_share_of_beams_that_end_nearer": _by_share(counted, [one.nearer for one in counted]),
        "right_in_the_end": sum(one.right_after_s is not None for one in counted) / max(len(counted), 1),
        "rides_with_wrong_floor": len(wrong),
        "wrong_floor_m": dict(sorted(ways.items())),
        "rides_with_wrong_place": sum(one.wrong_place_scans > 0 for one in counted),
        "rides_with_a_claim": sum(one.claimed_scans > 0 for one in counted),
        "wrong_rides": [one.number for one in wrong][:20],
    }


def _by_share(rides: Sequence[Ride], shares: Sequence[float]) -> dict[str, str]:
    """How many were right within SOON_S, by a share of the beams."""
    rows = list(zip((-1.0, *SHARES), (*SHARES, 1.0), strict=True))
    those = {
        f"{max(low, 0.0):.0%} to {high:.0%}": [
            ride for ride, share in zip(rides, shares, strict=True) if low < share <= high
        ]
        for low, high in rows
    }
    return {name: f"{_soon(each):.1%} of {len(each)}" for name, each in those.items() if each}


def _soon(rides: Sequence[Ride]) -> float:
    """Share of the rides that were right within SOON_S."""
    soon = [one for one in rides if one.right_after_s is not None and one.right_after_s <= SOON_S]
    return len(soon) / max(len(rides), 1)


def main() -> None:
    """Prints a line for each kind of stack, and one after each EVERY rides."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rides", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="number of the first ride")
    parser.add_argument("--kind", action="append", choices=("unlike", "refurnished", "alike"))
    parser.add_argument("--maps", type=Path, nargs="+", help="map_server yaml files, the floors")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    reported: list[dict[str, Any]] = []
    for kind, building in _chosen(arguments):
        rides: list[Ride] = []
        for ride in building.rides(range(arguments.first, arguments.first + arguments.rides)):
            rides.append(ride)
            if len(rides) % EVERY == 0 and len(rides) < arguments.rides:
                print(summary(kind, rides), flush=True)
        reported.append(summary(kind, rides) | {"each": [asdict(one) for one in rides]})
        print({key: value for key, value in reported[-1].items() if key != "each"}, flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(reported, indent=1), encoding="utf-8")


def _chosen(arguments: argparse.Namespace) -> Iterator[tuple[str, Building]]:
    if arguments.maps:
        yield "real", real(arguments.maps)
        return
    for kind in arguments.kind or ("unlike", "refurnished", "alike"):
        yield kind, buildings(kind)


if __name__ == "__main__":
    main()
