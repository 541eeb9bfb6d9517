"""How far a robot drives until it knows which of several like places it is in: advised, and by plain drives.

    .venv/bin/python benchmarks/advice.py [--seeds 101-102] [--starts 2] [--fov 360 --fov 180] [--json OUT]

Simulated buildings with like places (alike_worlds.py), a drawn start that is ambiguous also after a turn
on the spot, and the real cores in a closed loop with a simulated robot. Counted are the
metres to the claim that is right and stays so over the next 3 m; a run that has none within 20 m, or ends
after 240 s, counts as 20 m and as undecided. Drives:

    advised   follows the projector's advice; without any, it wanders
    wander    straight ahead; where that is blocked, towards a drawn free direction
    random    2 m towards a drawn free direction, and again

The constants of the projector's advice.py were chosen on seeds 1 to 6; the figures are of others.
"""

import argparse
import json
import os
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import ceil, cos, hypot, inf, pi, radians, remainder, sin, tau
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from alike_worlds import Alike, worlds
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.pose import compose, to_message, to_pose3
from eigenscan.geometry.raycast import RayCaster
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.channels import ADVICE, ODOMETRY, POSE, SCAN_RAW, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, Track, Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.lidar import Lidar
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROBOT = {"site": "alike", "robot": "r", "lidar": "front"}
PERIOD = 0.2
"""s from scan to scan."""
SPEED, TURN = 0.5, 1.2
"""m/s and rad/s."""
RADIUS = 0.25
"""m: nearer to a wall the robot stops."""
STANDS_S, SECOND = 1.0, 0.2
"""Before each drive the robot stands, turns round once and stands. Only then is its place ambiguous, with at
least so much of the belief elsewhere than at the best place: else any step would decide it."""
LIMIT_M, STAYS_M = 20.0, 3.0
RIGHT_M, RIGHT_RAD = 0.5, radians(10.0)
LEG_M = 2.0
"""m of the random drive's legs, and that an advised one wanders where its way is blocked."""
AHEAD_M = 0.5
"""m that must be free ahead."""
MOST_S = 240.0


def main() -> None:
    options = _options()
    rows = [row for seed in options.seeds for row in _of_seed(seed, options)]
    for line in _table(rows):
        print(line)
    figures = {"drives": _drives(rows), "per_run": rows}
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=_span, default="101-102", help="FIRST-LAST, of the buildings")
    parser.add_argument("--starts", type=int, default=2, help="in each building")
    parser.add_argument(
        "--fov", type=float, action="append", help="degrees, of the lidar; default 360 and 180"
    )
    parser.add_argument("--world", type=int, action="append", help="number of a kind; default all")
    parser.add_argument("--drive", action="append", choices=DRIVES, help="default: all")
    parser.add_argument("--verbose", action="store_true", help="a line for each run")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    options.drive = options.drive or list(DRIVES)
    options.fov = options.fov or [360.0, 180.0]
    return options


def _span(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def _second(message: Tracks) -> float:
    """Share of the tracks that are not at the most probable one's place."""
    best, *others = message.tracks or [Track()]
    return sum(
        t.probability for t in others if hypot(t.pose.x - best.pose.x, t.pose.y - best.pose.y) > 2 * RIGHT_M
    )


@dataclass
class Robot:
    """A robot in a building, and what its cores say."""

    world: Alike
    lidar: Lidar
    loop: Loopback
    seed: int
    pose: Array
    driven: float = 0.0
    turned: float = 0.0
    time: float = 0.0
    second: float = 0.0
    estimate: PoseEstimate = field(default_factory=PoseEstimate)
    advice: deque[Advice] = field(default_factory=lambda: deque(maxlen=1))

    def __post_init__(self) -> None:
        self.random = np.random.default_rng([self.seed, 7])
        self._wheels = np.zeros(3)
        self._caster, self._field = RayCaster.of(self.world.grid), DistanceField.of(self.world.grid)
        self._scale = 1.0 + 0.01 * self.random.standard_normal()

    def look(self) -> None:
        """A scan and odometry, and what the cores answer."""
        self.time += PERIOD
        at = stamp(1_000_000_000_000_000_000 + round(self.time * 1e9))
        ranges = self.lidar.measure(self._caster, self.pose, np.zeros((0, 2)), self.random)
        scan = RawScan(
            timestamp=at,
            mount=to_message(self.lidar.mount),
            angle_min=-self.lidar.fov / 2,
            angle_increment=self.lidar.angle_increment,
            range_min=self.lidar.range_min,
            range_max=self.lidar.range_max,
            ranges=ranges.tolist(),
        )
        wheels = Odometry(
            timestamp=at, frame_id="odom", body_frame_id="base_link", pose=to_pose3(self._wheels)
        )
        answers = [*self.loop.receive(Envelope(ODOMETRY, ROBOT, wheels))]
        answers += self.loop.receive(Envelope(SCAN_RAW, ROBOT, scan))
        for answer in answers:
            if answer.channel == POSE:
                self.estimate = answer.open(PoseEstimate)
            elif answer.channel == TRACKS:
                self.second = _second(answer.open(Tracks))
            elif answer.channel == ADVICE:
                self.advice.append(answer.open(Advice))

    def is_free(self, heading: float, distance: float = AHEAD_M) -> bool:
        """Whether the robot can drive so far along its own `heading`."""
        along = np.arange(0.05, distance + 0.05, 0.05)
        points = self.pose[:2] + along[:, None] * [cos(self.pose[2] + heading), sin(self.pose[2] + heading)]
        return bool((self._field.at(points)[0] > RADIUS).all())

    def move(self, ahead: float, turn: float) -> None:
        """A step, and what the wheels measure of it."""
        self.pose = compose(compose(self.pose, [0.0, 0.0, turn]), [ahead, 0.0, 0.0])
        turn += 0.02 * (abs(turn) ** 0.5) * self.random.standard_normal()
        turn += 0.01 * (ahead**0.5) * self.random.standard_normal()
        ahead = ahead * self._scale + 0.02 * (ahead**0.5) * self.random.standard_normal()
        self._wheels = compose(compose(self._wheels, [0.0, 0.0, turn]), [ahead, 0.0, 0.0])

    @property
    def claims(self) -> bool:
        """Whether a pose is claimed."""
        return self.estimate.state == STATE_LOCALIZED

    @property
    def is_right(self) -> bool:
        """Whether the claimed pose is right."""
        pose = self.estimate.pose
        away = hypot(pose.x - self.pose[0], pose.y - self.pose[1])
        return self.claims and away < RIGHT_M and abs(remainder(pose.theta - self.pose[2], tau)) < RIGHT_RAD


Leg = tuple[float, float]
"""A turn, rad, and a way, m."""


def _wander(robot: Robot) -> Iterator[Leg]:
    """Ahead until that is blocked, then towards a drawn free direction."""
    while True:
        yield (0.0, inf) if robot.is_free(0.0) else (_free_direction(robot), inf)


def _random(robot: Robot) -> Iterator[Leg]:
    while True:
        yield _free_direction(robot), LEG_M


def _advised(robot: Robot) -> Iterator[Leg]:
    """The advice; without any 0.5 m of the wandering, and where its way is blocked LEG_M."""
    wander = _wander(robot)
    while True:
        robot.advice.clear()
        for _ in range(round(1.2 / PERIOD)):  # it comes once a second
            if robot.advice or robot.claims:
                break
            yield 0.0, 0.0
        advice = robot.advice[0] if robot.advice else None
        if advice is None or advice.kind != Advice.KIND_MOVE:
            turn, way = next(wander)
            yield turn, min(way, 0.5)
            continue
        before = robot.driven
        yield advice.heading, advice.distance
        if advice.distance and robot.driven < before + 0.5 * advice.distance and not robot.claims:
            yield _free_direction(robot), LEG_M


def _free_direction(robot: Robot) -> float:
    """A drawn one of those with 1 m of free way, or of the freest."""
    for distance in (1.0, AHEAD_M, 0.3, 0.1):
        free = [turn for turn in np.arange(-pi, pi, pi / 12) if robot.is_free(turn, distance)]
        if free:
            return float(robot.random.choice(free))
    return pi


DRIVES = {"advised": _advised, "wander": _wander, "random": _random}


def _steps(robot: Robot, drive: str) -> Iterator[None]:
    """Turns and drives as the drive wants, a scan each step."""
    for turn, way in DRIVES[drive](robot):
        left = remainder(turn, tau)
        while abs(left) > 1e-6:
            part = max(-TURN * PERIOD, min(TURN * PERIOD, left))
            robot.move(0.0, part)
            robot.turned += abs(part)
            left -= part
            yield
        gone = 0.0
        while gone < way - 1e-6 and robot.is_free(0.0, min(AHEAD_M, way - gone)):
            part = min(SPEED * PERIOD, way - gone)
            robot.move(part, 0.0)
            robot.driven += part
            gone += part
            yield
        if not gone and not turn:
            yield


def _prelude(robot: Robot) -> float:
    """Stands, turns round once and stands; the time after it, s."""
    stands, turns = round(STANDS_S / PERIOD), ceil(tau / (TURN * PERIOD))
    for turn in [0.0] * stands + [tau / turns] * turns + [0.0] * stands:
        robot.move(0.0, turn)
        robot.look()
    return robot.time


def _run(
    world: Alike, models: Sequence[Envelope], lidar: Lidar, start: Array, seed: int, drive: str
) -> dict[str, Any] | None:
    """Figures of a run; None where the start is not ambiguous."""
    projector, tracker = ProjectorCore(ProjectorSettings()), TrackerCore(TrackerSettings())
    for model in models:
        for core in (projector, tracker):
            if model.channel in core.inputs:
                list(core.handle(model))
    robot = Robot(
        world, lidar, Loopback([ScanIngestCore(ScanIngestSettings()), projector, tracker]), seed, start
    )
    begun = _prelude(robot)
    if robot.claims or robot.estimate.state != STATE_AMBIGUOUS or robot.second < SECOND:
        return None
    since: tuple[float, float, float] | None = None
    robot.turned = 0.0
    first, false = LIMIT_M, 0
    for _ in _steps(robot, drive):
        robot.look()
        if not robot.is_right:
            false += robot.claims
            since = None
        elif since is None:
            since = robot.driven, robot.time, robot.turned
            first = min(first, robot.driven)
        if (since and robot.driven - since[0] >= STAYS_M) or robot.driven >= LIMIT_M + STAYS_M:
            break
        if robot.time > MOST_S or (since is None and robot.driven >= LIMIT_M):
            break
    counts = projector.condition().counters
    decided = since is not None and since[0] < LIMIT_M and robot.driven - since[0] >= STAYS_M
    return {
        "metres": since[0] if decided and since else LIMIT_M,
        "seconds": since[1] - begun if decided and since else None,
        "turned": since[2] if decided and since else None,
        "first_right": first,
        "decided": decided,
        "false_claims": false,
        "advised": counts.get("advised", 0),
        "advised_nothing": counts.get("advised_nothing", 0),
    }


def _of_seed(seed: int, options: argparse.Namespace) -> Iterator[dict[str, Any]]:
    for number, world in enumerate(worlds(seed)):
        if options.world and number not in options.world:
            continue
        for fov in options.fov:
            lidar = Lidar(round(fov), radians(fov - 1.0), 1 / PERIOD, range_max=12.0)
            settings = MapbuilderSettings(field_of_view=fov)
            models = list(MapbuilderCore(settings, build_site(world.grid, settings.plan)).start())
            kept = 0
            for i, start in enumerate(world.starts):
                if kept == options.starts:
                    break
                runs = dict[str, dict[str, Any]]()
                for drive in options.drive:
                    run = _run(world, models, lidar, start, 1000 * seed + i, drive)
                    if run is None:
                        break
                    runs[drive] = run
                else:
                    kept += 1
                    for drive, run in runs.items():
                        row = {
                            "world": world.name,
                            "seed": seed,
                            "fov": fov,
                            "start": i,
                            "drive": drive,
                            **run,
                        }
                        if options.verbose:
                            print(row, flush=True)
                        yield row


def _drives(rows: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Figures of each lidar and drive; of the advised one also beside the wandering one's."""
    found = dict[str, dict[str, Any]]()
    for fov in sorted({row["fov"] for row in rows}, reverse=True):
        for drive in DRIVES:
            driven = [row for row in rows if (row["fov"], row["drive"]) == (fov, drive)]
            if driven:
                found[f"{fov:.0f}°, {drive}"] = _figures(driven)
        advised, plain = (found.get(f"{fov:.0f}°, {drive}") for drive in ("advised", "wander"))
        if advised and plain:
            for what in ("mean_m", "median_m"):
                advised[f"{what}_beside"] = advised[what] / max(plain[what], 1e-9)
    return found


def _figures(rows: list[dict[str, Any]]) -> dict[str, Any]:
    metres = [row["metres"] for row in rows]
    return {
        "runs": len(rows),
        "mean_m": float(np.mean(metres)),
        "median_m": float(np.median(metres)),
        "first_right_mean_m": float(np.mean([row["first_right"] for row in rows])),
        "undecided": float(np.mean([not row["decided"] for row in rows])),
        "false": float(np.mean([row["false_claims"] > 0 for row in rows])),
    }


def _table(rows: list[dict[str, Any]]) -> Iterator[str]:
    """By lidar and kind of building, and of all."""
    yield "metres to the claim that is right and stays: median / mean, runs undecided within 20 m"
    drives = [drive for drive in DRIVES if any(row["drive"] == drive for row in rows)]
    yield f"{'lidar':6} {'building':20} {'runs':>4}  " + "".join(f"{drive:24}" for drive in drives)
    for fov in sorted({row["fov"] for row in rows}, reverse=True):
        for world in [*dict.fromkeys(row["world"] for row in rows), "all"]:
            of = [row for row in rows if row["fov"] == fov and world in (row["world"], "all")]
            if of:
                each = [_figures([row for row in of if row["drive"] == drive]) for drive in drives]
                cells = "".join(
                    f"{e['median_m']:5.1f} / {e['mean_m']:5.1f} m {100 * e['undecided']:4.0f} %   "
                    for e in each
                )
                yield f"{fov:4.0f}°  {world:20} {each[0]['runs']:4}  {cells}"


if __name__ == "__main__":
    main()
