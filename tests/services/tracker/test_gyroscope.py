"""A gyroscope's heading in place of the wheels' turn."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import hypot, inf, nan, pi

import numpy as np
import pytest
from eigenscan.schemas.channels import HEADING, ODOMETRY, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.tracker.gyroscope import GAP_NS, Gyroscope
from eigenscan.tracker.odometry import OdometryTrail
from eigenscan.tracker.planar import Pose, compose, wrap
from eigenscan.tracker.velocity_gate import VelocityGate
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from tests.services.tracker.conftest import MakeCore, Speaker

START = 1_000_000_000_000
ODOMETRY_NS, HEADING_NS = 20_000_000, 20_000_000
TURN_MAX = 3.0
DRIFT, NOISE = 0.02, 0.005
"""rad/s, and rad/s of each of 100 rates a second: a usual chip."""


@dataclass(frozen=True)
class Drive:
    """What is true, what the wheels measure and what the gyroscope sums up, each by stamp, ns."""

    truth: dict[int, Pose]
    wheels: dict[int, Pose]
    headings: dict[int, float]

    @property
    def end(self) -> int:
        return max(self.wheels)


def drive(slip: float = 0.15, still_s: float = 3.0, corners: int = 10, drift: float = DRIFT) -> Drive:
    """Stands, then drives sides of 2 m with corners of 90 degrees in which the wheels turn too far."""
    random = np.random.default_rng(1)
    speeds = [(0.0, 0.0)] * round(100 * still_s)
    for _ in range(corners):
        speeds += [(0.5, 0.0)] * 400 + [(0.2, pi / 2)] * 100
    truth, wheels, heading = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 40.0
    at, seen = START, Drive({}, {}, {})
    for step, (speed, rate) in enumerate([(0.0, 0.0), *speeds]):
        if step:
            at += 10_000_000
            # along the arc: the chord lies half-way between its two headings
            truth = compose(compose(truth, (0, 0, rate * 0.005)), (speed * 0.01, 0.0, rate * 0.005))
            turned = rate * (1.0 + slip) * 0.01
            wheels = compose(compose(wheels, (0, 0, turned / 2)), (speed * 0.01, 0.0, turned / 2))
            heading += 0.01 * (rate + drift + random.normal(0.0, NOISE))
        if step % 2 == 0:
            seen.truth[at], seen.wheels[at], seen.headings[at] = truth, wheels, heading
    return seen


def trail_of(seen: Drive, gyroscope: Gyroscope | None) -> OdometryTrail:
    steer = gyroscope.steer if gyroscope else None
    trail = OdometryTrail(VelocityGate(2.0, TURN_MAX), steer)
    for at, pose in seen.wheels.items():
        if gyroscope and at in seen.headings:
            gyroscope.receive(START, at, seen.headings[at])
        trail.take(at, pose)
    return trail


def heading_error(trail: OdometryTrail, seen: Drive) -> float:
    return abs(wrap(trail.between(START, seen.end).delta[2] - seen.truth[seen.end][2]))


def place_error(trail: OdometryTrail, seen: Drive) -> float:
    x, y, _ = trail.between(START, seen.end).delta
    true = seen.truth[seen.end]
    return hypot(x - true[0], y - true[1])


def test_a_robot_that_slips_in_turns_keeps_its_heading() -> None:
    seen = drive()
    wheels, both = trail_of(seen, None), trail_of(seen, Gyroscope(TURN_MAX, Counter()))
    # ten corners of 90 degrees, 15 % too far each
    assert heading_error(wheels, seen) == pytest.approx(10 * 0.15 * pi / 2, abs=0.01)
    # what three rests of a second leave of the drift, over 50 s: 0.0005 rad/s
    assert heading_error(both, seen) < 0.05
    assert place_error(wheels, seen) > 1.0
    assert place_error(both, seen) < 0.15


def test_without_slip_and_noise_it_changes_nothing() -> None:
    seen = drive(slip=0.0)
    exact = Drive(seen.truth, seen.wheels, {})
    theta = 0.0
    for before, at in zip([*[*seen.truth][:1], *seen.truth], seen.truth, strict=False):
        theta += wrap(seen.truth[at][2] - seen.truth[before][2])
        exact.headings[at] = theta
    wheels, both = trail_of(exact, None), trail_of(exact, Gyroscope(TURN_MAX, Counter()))
    assert both.between(START, seen.end).delta == pytest.approx(wheels.between(START, seen.end).delta)


def test_until_the_wheels_have_stood_they_count() -> None:
    seen, counts = drive(still_s=0.0), Counter[str]()
    wheels, both = trail_of(seen, None), trail_of(seen, Gyroscope(TURN_MAX, counts))
    assert both.between(START, seen.end) == wheels.between(START, seen.end)
    assert counts["heading_before_a_rest"] == len(seen.wheels) - 1


def test_drift_is_learnt_at_rest_and_only_there() -> None:
    gyroscope = Gyroscope(TURN_MAX, Counter())
    trail_of(drive(), gyroscope)
    assert gyroscope.drift == pytest.approx(DRIFT, abs=0.002)


def test_a_robot_that_is_turned_while_its_wheels_stand_teaches_no_drift() -> None:
    counts = Counter[str]()
    gyroscope = Gyroscope(TURN_MAX, counts)
    trail_of(drive(corners=0, drift=0.5), gyroscope)
    assert gyroscope.drift is None
    assert counts["heading_turns_at_rest"] == 2  # of three seconds, the first interval begins the rest


def test_a_gap_is_counted_and_bridged_by_the_wheels() -> None:
    seen, counts = drive(slip=0.0), Counter[str]()
    missing = [at for at in seen.headings if START + 10_000_000_000 < at < START + 12_000_000_000]
    for at in missing:
        del seen.headings[at]
    trail = trail_of(seen, Gyroscope(TURN_MAX, counts))
    assert counts["heading_interrupted"] == 1
    assert counts["odometry_without_heading"] >= len(missing)
    assert heading_error(trail, seen) < 0.05


def test_a_gyroscope_that_is_dead_or_mad_is_left_out_and_counted() -> None:
    seen, counts = drive(slip=0.0), Counter[str]()
    for at in seen.headings:
        seen.headings[at] = 1.0
    assert heading_error(trail_of(seen, Gyroscope(TURN_MAX, counts)), seen) < 0.01
    assert counts["heading_frozen"] >= 10 * 49  # 50 intervals a corner
    seen, counts = drive(slip=0.0), Counter[str]()
    for number, at in enumerate(seen.headings):
        seen.headings[at] += 50.0 * (number > 1000)
    assert heading_error(trail_of(seen, Gyroscope(TURN_MAX, counts)), seen) < 0.05
    assert counts["heading_jumped"] == 1


@pytest.mark.parametrize("hostile", [nan, inf, -inf, 1e300])
def test_what_is_no_heading_is_counted(hostile: float) -> None:
    counts = Counter[str]()
    gyroscope = Gyroscope(TURN_MAX, counts)
    gyroscope.receive(START, START, hostile)
    assert counts == {"heading_not_finite": 1}
    assert gyroscope.steer(START, START + 1, (1.0, 0.0, 0.5)) == (1.0, 0.0, 0.5)


def test_odometry_waits_for_a_heading_of_its_time_but_not_for_a_silent_gyroscope() -> None:
    gyroscope = Gyroscope(TURN_MAX, Counter())
    assert gyroscope.reaches(START, START)  # there is none
    gyroscope.receive(START, START, 0.0)
    assert gyroscope.reaches(START, START)
    assert not gyroscope.reaches(START + 1, START + 1)
    assert gyroscope.reaches(START + 1, START + GAP_NS + 1)


def _messages(seen: Drive, late_ns: int) -> list[Envelope]:
    """Odometry, headings that arrive `late_ns` after it, and ten lists of hypotheses a second."""
    address = {"site": "s", "robot": "r"}
    arrived: list[tuple[int, int, Envelope]] = []
    for number, (at, (x, y, theta)) in enumerate(seen.wheels.items()):
        odometry = Odometry(timestamp=stamp(at), frame_id="odom", body_frame_id="base")
        odometry.pose.position.x, odometry.pose.position.y = x, y
        odometry.pose.orientation.z, odometry.pose.orientation.w = np.sin(theta / 2), np.cos(theta / 2)
        arrived.append((at, 1, Envelope(ODOMETRY, address, odometry)))
        heading = Heading(timestamp=stamp(at), since=stamp(START), heading=seen.headings[at])
        # that there is a gyroscope shows with its first heading
        arrived.append((at + late_ns * (number > 0), 0, Envelope(HEADING, address, heading)))
        if number % 5 == 3:
            arrived.append((at, 2, Speaker().hypotheses(at * 1e-9, [seen.truth[at]], [20.0])))
    return [each for _, _, each in sorted(arrived, key=lambda one: one[:2])]


def _poses(make_core: MakeCore, messages: list[Envelope]) -> list[PoseEstimate]:
    core = make_core()
    published = [each for message in messages for each in core.handle(message)] + [*core.finish()]
    return [each.open(PoseEstimate) for each in published if each.channel is POSE]


@pytest.mark.parametrize("late_ns", [1, 15_000_000, 45_000_000])
def test_poses_do_not_depend_on_when_headings_arrive(make_core: MakeCore, late_ns: int) -> None:
    seen = drive(corners=2)
    in_time = _poses(make_core, _messages(seen, 0))
    assert len(in_time) == len([*seen.wheels]) // 5
    assert _poses(make_core, _messages(seen, late_ns)) == in_time
