"""Random and hostile sequences: whatever comes, masses sum to 1 and nothing is non-finite."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, POSE, RELOCATION, SCAN_MOTION, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.scan_pb2 import ScanMotion
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, Relocation, Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.odometry import ASKED_AT_MOST, OdometryTrail
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.velocity_gate import VelocityGate
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker

wild = st.one_of(
    st.floats(-20.0, 20.0),
    st.floats(allow_nan=True, allow_infinity=True),
    st.sampled_from([0.0, -0.0, math.pi, -math.pi, 1e-300, 1e300]),
)
times = st.one_of(st.integers(0, 3_000), st.integers(0, 10**7))
ADDRESS = {"site": "s", "robot": "r"}


@st.composite
def hypotheses(draw: st.DrawFn) -> Envelope:
    listed = [
        Hypothesis(
            pose=Pose2(x=draw(wild), y=draw(wild), theta=draw(wild)),
            covariance=Covariance3(**{name: draw(wild) for name in ("xx", "xy", "xt", "yy", "yt", "tt")})
            if draw(st.booleans())
            else Covariance3(xx=0.01, yy=0.01, tt=0.001),
            log_likelihood=draw(wild),
        )
        for _ in range(draw(st.integers(0, 5)))
    ]
    message = Hypotheses(
        timestamp=stamp(draw(times) * 1_000_000),
        frame_id=draw(st.sampled_from(["", "floor0", "floor1"])),
        status=draw(st.sampled_from(Hypotheses.Status.keys())),
        hypotheses=listed,
        unlisted_log_likelihood=draw(wild),
        searched_area_m2=draw(wild),
        inexactness=draw(wild),
    )
    lidar, projector = draw(st.sampled_from(["front", "rear"])), draw(st.sampled_from(["0", "1"]))
    return Envelope(HYPOTHESES, {**ADDRESS, "lidar": lidar, "projector": projector}, message)


@st.composite
def odometry(draw: st.DrawFn) -> Envelope:
    pose = Pose(
        position=Vector3(x=draw(wild), y=draw(wild)), orientation=Quaternion(z=draw(wild), w=draw(wild))
    )
    message = Odometry(
        timestamp=stamp(draw(times) * 1_000_000),
        pose=pose,
        pose_covariance=draw(st.lists(wild, max_size=36)),
    )
    return Envelope(ODOMETRY, ADDRESS, message)


@st.composite
def relocation(draw: st.DrawFn) -> Envelope:
    message = Relocation(
        timestamp=stamp(draw(times) * 1_000_000), frame_id=draw(st.sampled_from(["", "floor0"]))
    )
    if draw(st.booleans()):
        message.pose.CopyFrom(Pose2(x=draw(wild), y=draw(wild), theta=draw(wild)))
        message.covariance.CopyFrom(Covariance3(xx=draw(wild), yy=draw(wild), tt=draw(wild), xy=draw(wild)))
    return Envelope(RELOCATION, ADDRESS, message)


def check(output: list[Envelope]) -> None:
    for each in output:
        if each.channel is TRACKS:
            tracks = each.open(Tracks)
            masses = [track.probability for track in tracks.tracks]
            assert tracks.none_probability + sum(masses) == pytest.approx(1.0, abs=1e-9)
            assert min(masses, default=0.0) >= 0.0
            for track in tracks.tracks:
                c = track.covariance
                matrix = np.array([[c.xx, c.xy, c.xt], [c.xy, c.yy, c.yt], [c.xt, c.yt, c.tt]])
                assert np.isfinite([track.pose.x, track.pose.y, track.pose.theta]).all()
                assert -math.pi <= track.pose.theta < math.pi
                assert np.linalg.eigvalsh(matrix).min() > 0.0
        elif each.channel is POSE:
            pose = each.open(PoseEstimate)
            assert 0.0 <= pose.confidence <= 1.0
            assert 0.0 <= pose.none_probability <= 1.0 + 1e-9
            assert np.isfinite([pose.pose.x, pose.pose.y, pose.pose.theta]).all()
            assert np.isfinite([pose.map_to_odom.x, pose.map_to_odom.y, pose.map_to_odom.theta]).all()


@settings(max_examples=150, deadline=None)
@given(st.lists(st.one_of(hypotheses(), odometry(), relocation()), max_size=25))
def test_hostile_sequences(sequence: list[Envelope]) -> None:
    core = TrackerCore(TrackerSettings())
    for envelope in sequence:
        check(list(core.handle(envelope)))
    check(list(core.finish()))


TRUTH = np.array([4.0, 5.0, 1.0])


def standing(
    core: TrackerCore, speaker: Speaker, poses_of: PosesOf, start: float, scans: int
) -> list[PoseEstimate]:
    output = []
    for scan in range(scans):
        time = start + 0.1 * scan
        core.handle(speaker.odometry(time, np.array([1.0, 1.0, 0.0])))
        output += poses_of(
            core.handle(speaker.hypotheses(time, [TRUTH, np.add(TRUTH, [5, 0, 0])], [30.0, 15.0]))
        )
    return output


def is_right(message: PoseEstimate) -> bool:
    return bool(np.hypot(message.pose.x - TRUTH[0], message.pose.y - TRUTH[1]) < 0.1)


@pytest.mark.parametrize("pose", [[math.nan, 0, 0], [math.inf, 1, 1], [1, 1, math.nan]])
def test_odometry_that_is_no_number_is_set_aside(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, pose: ArrayLike
) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 5)
    core.handle(speaker.odometry(10.55, np.array(pose, dtype=float)))
    after = standing(core, speaker, poses_of, 10.6, 5)
    assert core.condition().counters["odometry_not_finite"] == 1
    assert all(m.state == STATE_LOCALIZED and is_right(m) for m in after)


@pytest.mark.parametrize(
    "change",
    [
        {"motion": Pose2(y=np.nan)},
        {"motion": Pose2(), "covariance": Covariance3(xx=1e-4, xy=2e-4, yy=1e-4)},
        {"motion": Pose2(), "covariance": Covariance3(xx=1e9, yy=1e9)},
        {"motion": Pose2(), "covariance": Covariance3(tt=np.inf)},
        {"motion": Pose2(), "covariance": Covariance3(xx=1e-4, xy=1e200, yy=1e-4)},
        {"motion": Pose2(), "since": stamp(10_900_000_000)},
    ],
)
def test_a_scan_motion_that_is_none_is_counted_and_moves_nothing(
    change: dict[str, Any], make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    plain, core = make_core(), make_core()
    for each in plain, core:
        standing(each, speaker, poses_of, 10.0, 5)
    seen = speaker.hypotheses(10.6, [], [])
    expected = poses_of(plain.handle(seen))
    bad: dict[str, Any] = {"timestamp": stamp(10_600_000_000), "since": stamp(10_500_000_000)} | change
    seen.open(Hypotheses).motion.CopyFrom(ScanMotion(**bad))
    assert poses_of(core.handle(seen)) == expected
    assert core.condition().counters["scan_motion_not_possible"] == 1


@pytest.mark.parametrize("moved", [Pose2(x=6e4), Pose2(theta=3.0)])
def test_a_scan_motion_that_no_robot_makes_is_no_motion(moved: Pose2, make_core: MakeCore) -> None:
    core = make_core()
    message = ScanMotion(motion=moved, since=stamp(10_500_000_000), timestamp=stamp(10_600_000_000))
    list(core.handle(Envelope(SCAN_MOTION, ADDRESS | {"lidar": "front"}, message)))
    assert core.condition().counters["scan_motion_too_fast"] == 1


def test_odometry_from_the_past_is_set_aside(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 5)
    core.handle(speaker.odometry(9.0, np.array([50.0, 1.0, 0.0])))
    after = standing(core, speaker, poses_of, 10.6, 5)
    assert core.condition().counters["odometry_from_past"] == 1
    assert all(is_right(m) and m.confidence > 0.89 for m in after)


def test_nothing_is_claimed_while_odometrys_stamps_have_gone_back(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """simtest, seed 8310757: a scan of a clock set back by 1.6 s was matched with odometry of before."""
    core, seen = make_core(), ([TRUTH, np.add(TRUTH, [5, 0, 0])], [30.0, 15.0])
    standing(core, speaker, poses_of, 10.0, 5)
    core.handle(speaker.odometry(10.0, np.array([1.0, 1.0, 0.0])))  # a message was overtaken
    late = poses_of(core.handle(speaker.hypotheses(10.42, *seen)))
    assert not core.handle(speaker.odometry(9.7, np.array([1.0, 1.0, 0.0])))  # no transform either
    set_back = poses_of(core.handle(speaker.hypotheses(10.47, *seen)))
    assert [m.state for m in (*late, *set_back)] == [STATE_LOCALIZED, STATE_AMBIGUOUS]
    assert "odometry's stamps went back by 0.7 s" in core.condition().detail
    assert all(is_right(m) for m in standing(core, speaker, poses_of, 10.6, 5)[-2:])
    assert "went back" not in core.condition().detail


def test_a_jump_of_odometry_lowers_the_confidence_until_a_scan_confirms(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    before = standing(core, speaker, poses_of, 10.0, 5)[-1]
    core.handle(speaker.odometry(10.5, np.array([11.0, 1.0, 0.0])))
    # a scan that shows nothing: only the jump is known
    blind = poses_of(core.handle(speaker.hypotheses(10.5, [], [], status=Hypotheses.STATUS_UNUSABLE_SCAN)))[0]
    assert core.condition().counters["odometry_taken_as_jump"] == 1
    assert blind.confidence < 0.6 < before.confidence
    output = []
    for scan in range(5):
        time = 10.6 + 0.1 * scan
        core.handle(speaker.odometry(time, np.array([11.0, 1.0, 0.0])))
        output += poses_of(
            core.handle(speaker.hypotheses(time, [TRUTH, np.add(TRUTH, [5, 0, 0])], [30.0, 15.0]))
        )
    assert output[-1].state == STATE_LOCALIZED
    assert is_right(output[-1])


def test_a_scan_from_the_future_is_set_aside(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 5)
    assert not list(core.handle(speaker.hypotheses(5000.0, [np.add(TRUTH, [9, 9, 0])], [60.0])))
    after = standing(core, speaker, poses_of, 10.6, 5)
    assert len(after) == 5
    assert all(is_right(m) for m in after)
    assert core.condition().counters["hypotheses_from_future"] == 1


@pytest.mark.parametrize("seconds", [2**62, -(2**62), 9_300_000_000])
def test_a_stamp_beyond_all_time_ends_nothing(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, seconds: int
) -> None:
    core = make_core()
    hostile = speaker.hypotheses(1.0, [TRUTH], [60.0])
    hostile.open(Hypotheses).timestamp.seconds = seconds
    core.handle(hostile)
    assert len(standing(core, speaker, poses_of, 10.0, 15)) >= 10
    core.finish()


def test_a_gap_in_the_log_is_no_future(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 5)
    after = standing(core, speaker, poses_of, 70.0, 5)
    assert len(after) == 5
    assert is_right(after[-1])


def test_without_odometry_scans_leave_no_more_behind_than_with_it() -> None:
    trail = OdometryTrail(VelocityGate(2.0, 3.0))
    trail.take(0, (0.0, 0.0, 0.0))
    for scan in range(10 * ASKED_AT_MOST):
        assert trail.at(scan * 100_000_000) is not None
    assert len(trail._asked) <= ASKED_AT_MOST


@pytest.mark.parametrize("apart_s", [1.1, 2.0, 30.0])
def test_sparse_scans_without_odometry_get_their_poses(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, apart_s: float
) -> None:
    core = make_core()
    output = [
        pose
        for scan in range(26)
        for pose in poses_of(core.handle(speaker.hypotheses(10.0 + apart_s * scan, [TRUTH], [60.0])))
    ]
    # one waits for odometry that never comes, and the first far stamp for another that confirms it
    assert len(output) >= 24
    assert is_right(output[-1])


def test_late_hypotheses_of_a_second_lidar_count(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for scan in range(10):
        time = 10.0 + 0.1 * scan
        core.handle(speaker.odometry(time, np.array([0.1 * scan, 0.0, 0.0])))
        aliases = [np.array([1.0 + 0.1 * scan, 2.0, 0.0]), np.array([9.0 + 0.1 * scan, 2.0, 0.0])]
        message = poses_of(core.handle(speaker.hypotheses(time, aliases, [30.0, 30.0])))[0]
    assert message.state != STATE_LOCALIZED
    late = speaker.hypotheses(10.5, [np.array([1.5, 2.0, 0.0])], [30.0], lidar="rear")
    message = poses_of(core.handle(late))[0]
    assert message.state == STATE_LOCALIZED
    assert message.pose.x == pytest.approx(1.9, abs=0.1)
    too_late = speaker.hypotheses(10.1, [np.array([1.1, 2.0, 0.0])], [30.0], lidar="rear")
    assert not poses_of(core.handle(too_late))
    assert core.condition().counters["hypotheses_too_late"] == 1


def test_a_repeated_message_counts_once(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 3)
    assert not poses_of(core.handle(speaker.hypotheses(10.1, [TRUTH], [30.0])))
    assert core.condition().counters["hypotheses_duplicate"] == 1


def test_a_clock_set_back_starts_again(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    standing(core, speaker, poses_of, 1000.0, 5)
    output = standing(core, speaker, poses_of, 10.0, 20)
    assert len(output) >= 15
    assert output[-1].state == STATE_LOCALIZED
    assert is_right(output[-1])


def test_after_odometry_whose_clock_was_set_back_nothing_of_before_is_claimed(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Seed 4724: set back by 6.4 s; after 8 s the stamps were 1.6 s on, and the claim was 5.6 m off."""
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 20)
    for time in np.arange(12.0, 20.0, 0.2).tolist():
        core.handle(speaker.odometry(time - 6.4, np.array([1.0 + 0.5 * (time - 12.0), 1.0, 0.0])))
    nothing = speaker.hypotheses(13.3, [], [], status=Hypotheses.STATUS_UNUSABLE_SCAN)
    pose = poses_of(core.handle(nothing))[0]
    assert core.condition().counters["odometry_restarted"] == 1
    assert pose.state != STATE_LOCALIZED
    assert pose.confidence < 0.1


def test_covariances_that_are_none_are_replaced(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    speaker.covariance = np.diag([-1.0, 0.0, 0.0])
    speaker.clutter = 0
    message = poses_of(core.handle(speaker.hypotheses(1.0, [TRUTH], [60.0])) or core.finish())[0]
    assert core.condition().counters["covariance_replaced"] == 1
    assert message.covariance.xx == pytest.approx(0.25**2, rel=0.01)


def test_robots_do_not_share_a_belief(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    one = speaker.hypotheses(1.0, [TRUTH], [40.0])
    two = speaker.hypotheses(1.0, [np.add(TRUTH, [3, 0, 0])], [40.0])
    two = Envelope(two.channel, {**two.address, "robot": "other"}, two.message)
    core.handle(one)
    core.handle(two)
    output = list(core.finish())
    found = {e.address["robot"]: e.open(PoseEstimate).pose.x for e in output if e.channel is POSE}
    assert found == pytest.approx({"r": TRUTH[0], "other": TRUTH[0] + 3})


def test_a_message_of_other_floors_leaves_a_floor_alone(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for scan in range(6):
        time = 10.0 + 0.1 * scan
        core.handle(speaker.odometry(time, np.zeros(3)))
        core.handle(speaker.hypotheses(time, [TRUTH], [30.0], projector="ground", frame="ground"))
        output = poses_of(
            core.handle(
                speaker.hypotheses(time, [np.add(TRUTH, [2, 0, 0])], [12.0], projector="first", frame="first")
            )
        )
    assert output[-1].state == STATE_LOCALIZED
    assert output[-1].frame_id == "ground"


def test_names_without_end_are_forgotten_and_reported(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """3,000 invented ones stayed for ever: each scan took 25 times as long, and health was OK."""
    core = make_core()
    standing(core, speaker, poses_of, 10.0, 5)
    for number in range(600):
        name = f"p{number}"
        core.handle(speaker.hypotheses(10.5 + 1e-4 * number, [TRUTH], [30.0], projector=name, frame=name))
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "more than 256 sources" in condition.detail
    assert condition.counters["sources_forgotten"] == 512
    assert is_right(standing(core, speaker, poses_of, 20.0, 300)[-1])
    assert core.condition().status == Health.STATUS_OK
