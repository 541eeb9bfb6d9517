"""Robot, lidar and people together, as the messages that a real robot would send."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.pose import Array, to_message, to_pose3
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, ODOMETRY, SCAN_RAW, TRUTH
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.people import draw_walkers, positions, stander
from eigenscan.workbench.simulation.robot import (
    KIDNAP_DISTANCE,
    TICKS_PER_S,
    Drive,
    OdometryNoise,
    drive_route,
    odometry,
)
from eigenscan.workbench.simulation.route import plan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

EPOCH_NS = 1_000_000_000 * 1_000_000_000
"""Stamp of a recorded simulation's start: fixed, so that runs can be compared."""

ODOMETRY_EVERY = 2  # ticks
SCAN_PHASE = 1  # ticks: a scan never falls on an odometry stamp, as on real robots


@dataclass(frozen=True)
class Scenario:
    """All that decides a simulation: the same scenario on the same map gives the same bytes."""

    seconds: float = 60.0
    kidnap: float | None = None  # s after the start; None: never
    seed: int = 1
    people: int = 3
    start: tuple[float, float] | None = None  # m, map frame; None: drawn
    kidnap_to: tuple[float, float] | None = None
    goals: tuple[tuple[float, float], ...] = ()  # m, driven to in this order before any is drawn
    standing: tuple[tuple[float, float], ...] = ()  # m, people who stand still
    lidar: Lidar = field(default_factory=Lidar)
    drive: Drive = field(default_factory=Drive)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    site: str = DEFAULT_SITE
    robot: str = DEFAULT_ROBOT
    lidar_name: str = "front"
    number: int = 0  # number of the robot in a fleet: another route among the same people


@dataclass(frozen=True)
class Timed:
    """A message and when it is sent, in ns of simulated time."""

    time: int
    envelope: Envelope


class Stage:
    """One simulation on one map. Raises MapError if the robot fits nowhere.

    `epoch`, ns: stamp of the first message; fixed, unless a live robot sets it to the present.
    """

    def __init__(self, grid: GridMap, scenario: Scenario) -> None:
        self.grid, self.scenario = grid, scenario
        self.epoch = EPOCH_NS
        self.others: Sequence[Stage] = ()
        # a stream each: more people do not change the route, nor a longer drive the noise
        route, people, wheels, self._beams_seed = np.random.SeedSequence(scenario.seed).spawn(4)
        if scenario.number:
            own = np.random.SeedSequence((scenario.seed, scenario.number))
            route, _, wheels, self._beams_seed = own.spawn(4)
        self._planner = plan(grid, scenario.drive.radius)
        self._walls = RayCaster.of(grid)
        self._walls.cast(np.zeros(3), np.zeros(1), 1.0)  # compiled now, not at the first scan
        self._walkers = draw_walkers(self._planner, scenario.people, np.random.default_rng(people))
        self._walkers += [stander(place) for place in scenario.standing]
        self.poses, self.jumps = self._drive(np.random.default_rng(route))
        self.odometry = odometry(self.poses, self.jumps, scenario.odometry, np.random.default_rng(wheels))

    @property
    def times(self) -> NDArray[np.int64]:
        """Stamps (n,) of the poses, ns."""
        return self.epoch + np.arange(len(self.poses)) * (1_000_000_000 // TICKS_PER_S)

    @cached_property
    def scan_ticks(self) -> NDArray[np.int64]:
        """Indices (k,) of the poses at which scans are taken."""
        count = int(self.scenario.seconds * self.scenario.lidar.rate)
        ticks = np.round(np.arange(count) * TICKS_PER_S / self.scenario.lidar.rate).astype(np.int64)
        ticks = ticks // ODOMETRY_EVERY * ODOMETRY_EVERY + SCAN_PHASE
        return ticks[ticks < len(self.poses)]

    def pose_at(self, time: int) -> Array:
        """True pose (3,) of the base at the stamp `time`, ns, or at the nearest one there is."""
        tick = round((time - self.epoch) * TICKS_PER_S / 1e9)
        pose: Array = self.poses[min(max(tick, 0), len(self.poses) - 1)]
        return pose

    def people_at(self, time: int) -> Array:
        """Centres of the people and of other robots (n, 2), m, map frame, at the stamp `time`, ns."""
        people = positions(self._walkers, (time - self.epoch) * 1e-9, self.pose_at(time)[:2])
        return np.vstack([people, *(other.pose_at(time)[:2] for other in self.others)])

    @property
    def kidnap_time(self) -> int | None:
        """Stamp of the first pose after the kidnap, ns."""
        return int(self.times[self.jumps[0]]) if len(self.jumps) else None

    def _drive(self, random: np.random.Generator) -> tuple[Array, NDArray[np.int64]]:
        scenario, planner = self.scenario, self._planner
        total = max(2, round(scenario.seconds * TICKS_PER_S))
        first = total if scenario.kidnap is None else min(total, max(1, round(scenario.kidnap * TICKS_PER_S)))
        start = planner.draw_goal(random, np.zeros(2), 0.0)
        if scenario.start is not None:
            start = np.array(scenario.start)
        poses = drive_route(planner, start, first, scenario.drive, random, scenario.goals)
        if first == total:
            return poses, np.empty(0, dtype=np.int64)
        elsewhere = planner.draw_goal(random, poses[-1, :2], KIDNAP_DISTANCE)
        if scenario.kidnap_to is not None:
            elsewhere = np.array(scenario.kidnap_to)
        rest = drive_route(planner, elsewhere, total - first, scenario.drive, random)
        return np.concatenate([poses, rest]), np.array([first])

    def messages(self) -> Iterator[Timed]:
        """Odometry, raw scans and the truth at each scan, in order of time."""
        random = np.random.default_rng(self._beams_seed)
        scans = set(self.scan_ticks.tolist())
        for tick, time in enumerate(self.times.tolist()):
            if tick % ODOMETRY_EVERY == 0:
                yield Timed(time, self._publish_odometry(tick, time))
            if tick in scans:
                yield Timed(time, self._publish_truth(tick, time))
                yield Timed(time, self._publish_scan(tick, time, random))

    @property
    def keys(self) -> list[str]:
        """Every key that messages are published on."""
        return [channel.key(self._address) for channel in (ODOMETRY, SCAN_RAW, TRUTH)]

    @property
    def _address(self) -> dict[str, str]:
        scenario = self.scenario
        return {"site": scenario.site, "robot": scenario.robot, "lidar": scenario.lidar_name}

    def _publish_odometry(self, tick: int, time: int) -> Envelope:
        message = Odometry(
            timestamp=stamp(time),
            frame_id="odom",
            body_frame_id="base_link",
            pose=to_pose3(self.odometry[tick]),
        )
        return Envelope(ODOMETRY, self._address, message)

    def _publish_truth(self, tick: int, time: int) -> Envelope:
        message = PoseInFrame(timestamp=stamp(time), frame_id="map", pose=to_pose3(self.poses[tick]))
        return Envelope(TRUTH, self._address, message)

    def _publish_scan(self, tick: int, time: int, random: np.random.Generator) -> Envelope:
        lidar, people = self.scenario.lidar, self.people_at(time)
        ticks = tick + np.arange(round(lidar.sweep * TICKS_PER_S) + 1)
        swept = self.poses[np.minimum(ticks, len(self.poses) - 1)]
        message = RawScan(
            timestamp=stamp(time),
            frame_id=self.scenario.lidar_name,
            mount=to_message(lidar.mount),
            angle_min=-lidar.fov / 2,
            angle_increment=lidar.angle_increment,
            range_min=lidar.range_min,
            range_max=lidar.range_max,
            ranges=lidar.measure(self._walls, swept, people, random).tolist(),
            time_increment=lidar.time_increment,
        )
        return Envelope(SCAN_RAW, self._address, message)


class Fleet:
    """`count` robots; if there are several, they are named r1, r2, … after the scenario's robot r.

    They do not give way to each other. Raises MapError if a robot fits nowhere.
    """

    def __init__(self, grid: GridMap, scenario: Scenario, count: int = 1) -> None:
        names = [scenario.robot] if count == 1 else [f"{scenario.robot}{k}" for k in range(1, count + 1)]
        self.stages = [
            Stage(grid, replace(scenario, robot=name, number=number)) for number, name in enumerate(names)
        ]
        for stage in self.stages:
            stage.others = [other for other in self.stages if other is not stage]

    def begin(self, epoch: int) -> None:
        """Sets the stamp of the first message, ns."""
        for stage in self.stages:
            stage.epoch = epoch

    def messages(self) -> Iterator[Timed]:
        """Those of all robots, in order of time."""
        return heapq.merge(*(stage.messages() for stage in self.stages), key=lambda timed: timed.time)
