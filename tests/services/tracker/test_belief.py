from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.schemas.channels import TRACKS
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, STATE_LOST, PoseEstimate, Tracks
from eigenscan.tracker.belief import MISSES, Belief, emerges
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.evidence import EMERGES, HIDES, SHOWN_YET_MISSED, SHOWS
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.unification import settle
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logit

from tests.services.tracker.conftest import MakeCore, PosesOf, Speaker, TracksOf

STEP = np.array([0.05, 0.0, 0.02])


def drive(
    core: TrackerCore,
    speaker: Speaker,
    poses_of: PosesOf,
    *,
    scans: int,
    start: tuple[float, float, float] = (2.0, 3.0, 0.0),
    jump_at: int | None = None,
    time: float = 100.0,
) -> list[tuple[PoseEstimate, np.ndarray]]:
    """One right hypothesis among wrong ones that change from scan to scan; gives (pose message, truth)."""
    rng = np.random.default_rng(1)
    truth, odometry = np.array(start), np.zeros(3)
    received = []
    for scan in range(scans):
        time += 0.1
        if scan == jump_at:
            truth = np.array([14.0, 11.0, 2.0])
        truth, odometry = compose(truth, STEP), compose(odometry, STEP * 1.02)
        poses = [truth + rng.normal(size=3) * [0.03, 0.03, 0.01]]
        logs = [30.0 + rng.normal()]
        for _ in range(8):
            poses.append(rng.uniform([0, 0, -3], [20, 20, 3]))
            logs.append(15.0 + 3.0 * rng.normal())
        core.handle(speaker.odometry(time, odometry))
        for message in poses_of(core.handle(speaker.hypotheses(time, poses, logs))):
            received.append((message, truth))
    return received


def is_right(message: PoseEstimate, truth: np.ndarray) -> bool:
    turn = (message.pose.theta - truth[2] + np.pi) % (2 * np.pi) - np.pi
    near = np.hypot(message.pose.x - truth[0], message.pose.y - truth[1]) < 0.5
    return bool(near and abs(turn) < np.radians(10))


def test_one_sure_scan_localizes(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    message, truth = drive(make_core(), speaker, poses_of, scans=1)[0]
    assert message.state == STATE_LOCALIZED
    assert is_right(message, truth)
    assert message.confidence == pytest.approx(0.9)  # of a robot that has not moved


def test_tracks_a_driving_robot(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    received = drive(make_core(), speaker, poses_of, scans=100)
    errors = [np.hypot(m.pose.x - t[0], m.pose.y - t[1]) for m, t in received]
    assert len(received) == 100
    assert np.median(errors) < 0.03
    assert all(m.state == STATE_LOCALIZED and is_right(m, t) for m, t in received)
    assert len({m.track_id for m, _ in received}) == 1


def test_kidnap_is_noticed_and_recovered(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    received = drive(make_core(), speaker, poses_of, scans=80, jump_at=40)
    wrong_claims = [
        i for i, (m, t) in enumerate(received) if m.state == STATE_LOCALIZED and not is_right(m, t)
    ]
    right = [
        i for i, (m, t) in enumerate(received) if i >= 40 and m.state == STATE_LOCALIZED and is_right(m, t)
    ]
    assert all(40 <= i < 50 for i in wrong_claims)
    assert right
    assert right[0] < 50
    assert right == list(range(right[0], 80))


def symmetric(count: int) -> list[np.ndarray]:
    return [np.array([3.0 * k, 2.0, 0.3]) for k in range(count)]


def test_standing_in_a_symmetric_place_stays_ambiguous(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, tracks_of: TracksOf
) -> None:
    core, rng = make_core(), np.random.default_rng(2)
    for scan in range(600):
        time = 10.0 + scan * 0.1
        core.handle(speaker.odometry(time, np.zeros(3)))
        output = core.handle(speaker.hypotheses(time, symmetric(4), 18.0 + 0.5 * rng.normal(size=4)))
        assert poses_of(output)[0].state == STATE_AMBIGUOUS
        assert len([t for t in tracks_of(output)[0].tracks if t.probability > 0.05]) == 4


def test_a_symmetric_place_is_left_by_what_breaks_it(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    odometry = np.zeros(3)
    poses = symmetric(4)
    for scan in range(40):
        time = 10.0 + scan * 0.1
        odometry = compose(odometry, STEP)
        poses = [compose(pose, STEP) for pose in poses]
        core.handle(speaker.odometry(time, odometry))
        logs = [30.0, 30.0, 30.0, 30.0] if scan < 15 else [30.0, 20.0, 20.0, 20.0]
        message = poses_of(core.handle(speaker.hypotheses(time, poses, logs)))[0]
        if scan < 15:
            assert message.state == STATE_AMBIGUOUS
    assert message.state == STATE_LOCALIZED
    assert message.pose.x == pytest.approx(poses[0][0], abs=0.05)


def sure_after(core: TrackerCore, speaker: Speaker, poses_of: PosesOf, **stated: Any) -> float:
    """m driven along two places of which one fits a little better, until it is claimed."""
    odometry, poses = np.zeros(3), symmetric(2)
    for scan in range(200):
        time = 10.0 + scan * 0.1
        odometry, poses = compose(odometry, STEP), [compose(pose, STEP) for pose in poses]
        core.handle(speaker.odometry(time, odometry))
        lists = speaker.hypotheses(time, poses, [19.0, 18.0], **stated)
        if poses_of(core.handle(lists))[0].state == STATE_LOCALIZED:
            return 0.05 * scan
    return math.inf


def test_errors_of_an_inexact_map_are_alike_along_the_way(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    exact, thin, thick = (
        sure_after(make_core(), speaker, poses_of, inexactness=own) for own in (0.0, 0.1, 0.2)
    )
    # beside a lidar's 5 cm; what the first place shows needs no way
    assert (thick - exact) / (thin - exact) == pytest.approx((17**0.5 - 1) / (5**0.5 - 1), rel=0.1)


def test_gathered_scans_show_new_places_as_slowly_as_they_forget(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Each showed again what those before it did: a place that merely looks right was claimed."""
    one, short, long = (
        sure_after(make_core(), speaker, poses_of, gathered=way) for way in (0.4, 1.0, 1.5)
    )  # m; independence_m is 0.5
    assert one == sure_after(make_core(), speaker, poses_of)
    assert (long - one) / (short - one) == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("field", ["gathered", "inexactness"])
@pytest.mark.parametrize("metres", [math.nan, math.inf, -1.0, 1e300])
def test_what_is_no_length_counts_as_none(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, field: str, metres: float
) -> None:
    found = sure_after(make_core(), speaker, poses_of, **{field: metres})
    assert found == sure_after(make_core(), speaker, poses_of)


def test_a_scan_that_nothing_explains_leaves_the_robot_lost(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    message = poses_of(core.handle(speaker.hypotheses(1.0, [], [])) or core.finish())[0]
    assert message.state == STATE_LOST
    assert message.none_probability == pytest.approx(1.0)
    assert message.track_id == 0


def test_leaving_the_map_is_noticed(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core = make_core()
    received = drive(core, speaker, poses_of, scans=30)
    assert received[-1][0].state == STATE_LOCALIZED
    states = []
    speaker.unlisted = -20.0
    for scan in range(30):
        time = 103.0 + 0.1 * (scan + 1)
        core.handle(speaker.odometry(time, np.array([0.05 * scan, 0.0, 0.0])))
        states += [m.state for m in poses_of(core.handle(speaker.hypotheses(time, [], [])))]
    assert STATE_LOCALIZED not in states[10:]
    assert states[-1] == STATE_LOST


def test_without_odometry_it_still_converges(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    truth = np.array([2.0, 3.0, 0.0])
    messages = []
    for scan in range(40):
        truth = compose(truth, STEP)
        messages += poses_of(
            core.handle(
                speaker.hypotheses(5.0 + 0.1 * scan, [truth, np.add(truth, [6.0, 0.0, 1.0])], [30.0, 18.0])
            )
        )
    last = messages[-1]
    assert last.state == STATE_LOCALIZED
    assert not last.has_odometry
    assert np.hypot(last.pose.x - truth[0], last.pose.y - truth[1]) < 0.05
    # one that never gave odometry is not waited for
    assert len(messages) == 40


def test_masses_sum_to_one(make_core: MakeCore, speaker: Speaker, tracks_of: TracksOf) -> None:
    core = make_core()
    rng = np.random.default_rng(3)
    for scan in range(50):
        poses = rng.uniform([0, 0, -3], [20, 20, 3], (30, 3))
        for message in tracks_of(core.handle(speaker.hypotheses(1.0 + scan, poses, rng.normal(10, 10, 30)))):
            total = message.none_probability + sum(track.probability for track in message.tracks)
            assert total == pytest.approx(1.0, abs=1e-9)


def make_stream(speaker: Speaker, scans: int) -> tuple[list[Envelope], list[Envelope]]:
    truth, odometry, rng = np.array([2.0, 3.0, 0.0]), np.zeros(3), np.random.default_rng(4)
    odometries, hypotheses = [], []
    for scan in range(scans):
        truth, odometry = compose(truth, STEP), compose(odometry, STEP)
        time = 50.0 + 0.1 * scan
        odometries.append(speaker.odometry(time + 0.013, odometry))
        poses = [truth + rng.normal(size=3) * 0.02, rng.uniform([0, 0, -3], [20, 20, 3])]
        hypotheses.append(speaker.hypotheses(time, poses, [25.0, 15.0]))
    return odometries, hypotheses


Published = list[tuple[int, bytes]]


def run(core: TrackerCore, envelopes: Iterable[Envelope], poses_of: PosesOf) -> Published:
    output = []
    for envelope in envelopes:
        output += poses_of(core.handle(envelope))
    output += poses_of(core.finish())
    return [(m.timestamp.ToNanoseconds(), m.SerializeToString(deterministic=True)) for m in output]


def test_order_of_arrival_between_channels_does_not_matter(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    odometries, hypotheses = make_stream(speaker, 30)
    rng = np.random.default_rng(5)
    both = [*odometries, *hypotheses]
    received: list[Odometry | Hypotheses] = [
        *(e.open(Odometry) for e in odometries),
        *(e.open(Hypotheses) for e in hypotheses),
    ]
    stamps = np.array([message.timestamp.ToNanoseconds() * 1e-9 for message in received])
    expected = run(make_core(), [both[i] for i in np.argsort(stamps, kind="stable")], poses_of)
    assert len(expected) == 30
    for _ in range(20):
        # each channel keeps its own order; between them up to the patience of 0.2 s
        delay = np.repeat(rng.uniform(0.0, 0.19, 2), 30)
        shuffled = [both[i] for i in np.argsort(stamps + delay, kind="stable")]
        assert run(make_core(), shuffled, poses_of) == expected


def test_a_scan_whose_odometry_does_not_come_in_time_is_counted(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """The answer then hangs on what was there when: a replay must have it."""
    odometries, hypotheses = make_stream(speaker, 30)
    core = make_core()
    for odometry, seen in zip(odometries[:10], hypotheses[:10], strict=True):
        core.handle(odometry)
        core.handle(seen)
    assert core.condition().counters.get("odometry_came_late", 0) == 0
    for seen in hypotheses[10:15]:  # 1.0 s to 1.4 s, the newest odometry is of 0.913 s
        core.handle(seen)
    for odometry in odometries[10:15]:
        core.handle(odometry)
    # all that are 0.2 s older than the newest, but for 1.0, which the last velocity reaches: 1.1, 1.2
    assert core.condition().counters["odometry_came_late"] == 2


def others(rng: np.random.Generator, count: int = 12) -> list[np.ndarray]:
    return [*rng.uniform([0, 0, -3], [40, 40, 3], (count, 3))]


def test_carried_away_is_noticed_at_once_and_found_again(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Nothing of a list goes on in the next one, though odometry stands still."""
    core, rng = make_core(), np.random.default_rng(6)
    speaker.clutter = 0
    time, messages = 10.0, []
    for place in (np.array([2.0, 3.0, 0.4]), np.array([17.0, 8.0, -2.0])):
        aliases = others(rng)
        for _ in range(30):
            time += 0.1
            core.handle(speaker.odometry(time, np.zeros(3)))
            output = core.handle(speaker.hypotheses(time, [place, *aliases], [17.0] + [8.0] * 12))
            messages += [(message, place) for message in poses_of(output)]
    assert not [m for m, place in messages if m.state == STATE_LOCALIZED and not is_right(m, place)]
    assert all(m.state == STATE_LOCALIZED for m, _ in [*messages[5:30], *messages[35:]])


def test_carried_away_is_noticed_where_two_of_ten_go_on_by_chance(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core, rng = make_core(), np.random.default_rng(6)
    speaker.clutter, time, messages = 0, 10.0, []
    same = others(rng, 2)
    for place in (np.array([2.0, 3.0, 0.4]), np.array([17.0, 8.0, -2.0])):
        aliases = [*same, *others(rng, 10)]
        for _ in range(30):
            time += 0.1
            core.handle(speaker.odometry(time, np.zeros(3)))
            output = core.handle(speaker.hypotheses(time, [place, *aliases], [19.0] + [9.0] * 12))
            messages += [(message, place) for message in poses_of(output)]
    claims = [(m.state == STATE_LOCALIZED, is_right(m, place)) for m, place in messages]
    assert all(claim == (True, True) for claim in [*claims[5:30], *claims[40:]])
    assert (True, False) not in claims[33:]


def test_one_sparse_list_of_what_the_map_lacks_does_not_end_the_claim(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Nothing of them goes on over most of a metre, but odometry is still sure."""
    core, rng = make_core(released_below=0.7), np.random.default_rng(13)
    speaker.clutter = 0
    truth, odometry, step = np.array([2.0, 3.0, 0.0]), np.zeros(3), np.array([0.8, 0.0, 0.1])
    for scan in range(14):
        time = 10.0 + 2.0 * scan
        truth, odometry = compose(truth, step), compose(odometry, step)
        core.handle(speaker.odometry(time, odometry))
        lacking = scan >= 11
        poses, logs = [truth, *others(rng)], [17.0] + [6.0] * 12
        output = core.handle(speaker.hypotheses(time, poses[lacking:], logs[lacking:]))
        if scan > 2:
            message = poses_of(output)[0]
            # after a metre without a confirmation an eighth of the belief elsewhere ends it
            assert message.state == STATE_LOCALIZED or scan >= 12
            assert is_right(message, truth)


def test_a_covered_sensor_costs_the_claim_only_while_it_is_covered(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core, rng = make_core(), np.random.default_rng(7)
    speaker.clutter = 0
    place, aliases = np.array([2.0, 3.0, 0.4]), others(rng)
    time, states = 10.0, []
    for scan in range(60):
        time += 0.1
        covered = 30 <= scan < 40
        poses = others(rng, 13) if covered else [place, *aliases]
        core.handle(speaker.odometry(time, np.zeros(3)))
        output = core.handle(speaker.hypotheses(time, poses, ([7.0] if covered else [17.0]) + [6.0] * 12))
        states += [(m.state, is_right(m, place)) for m in poses_of(output)]
    assert all(state == (STATE_LOCALIZED, True) for state in states[5:30])
    assert all(state == (STATE_LOCALIZED, True) for state in states[42:])
    assert not any(state == STATE_LOCALIZED and not right for state, right in states)


@pytest.mark.slow
def test_a_robot_that_stands_for_an_hour_stays_sure(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    core = make_core()
    for scan in range(3600):
        time = 10.0 + scan
        core.handle(speaker.odometry(time, np.zeros(3)))
        output = poses_of(core.handle(speaker.hypotheses(time, [[2.0, 3.0, 0.4]], [17.0])))
        assert [m.state for m in output] == [STATE_LOCALIZED]


def test_a_stretch_that_the_map_hardly_shows_is_driven_through(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Two metres on odometry, while a wrong place fits a little: the claim stays with the track."""
    core, rng = make_core(), np.random.default_rng(8)
    truth, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
    wrong = np.array([15.0, 12.0, 1.0])
    for scan in range(100):
        time = 10.0 + 0.1 * scan
        truth, odometry, wrong = (compose(pose, STEP) for pose in (truth, odometry, wrong))
        core.handle(speaker.odometry(time, odometry))
        seen = truth + rng.normal(size=3) * [0.03, 0.03, 0.01]
        poses, logs = ([wrong], [10.0]) if 40 <= scan < 80 else ([seen, wrong], [17.0, 10.0])
        message = poses_of(core.handle(speaker.hypotheses(time, poses, logs)))[0]
        if scan > 5:
            assert message.state == STATE_LOCALIZED
            assert is_right(message, truth)


def test_a_similar_place_does_not_take_a_robot_from_where_it_drove(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Two metres that the map lacks, while another room fits as well as the right one does elsewhere."""
    core, rng = make_core(), np.random.default_rng(8)
    truth, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
    wrong, aliases = np.array([15.0, 12.0, 1.0]), others(rng, 6)
    received, speaker.clutter = [], 0
    for scan in range(100):
        truth, odometry, wrong = (compose(pose, STEP) for pose in (truth, odometry, wrong))
        aliases = [compose(pose, STEP) for pose in aliases]
        core.handle(speaker.odometry(10.0 + 0.1 * scan, odometry))
        lacking = 40 <= scan < 80
        poses = [wrong if lacking else truth + rng.normal(size=3) * [0.03, 0.03, 0.01], *aliases]
        output = core.handle(speaker.hypotheses(10.0 + 0.1 * scan, poses, [15.5, *[7.0] * 6]))
        received += [(message, truth) for message in poses_of(output)]
    assert all(is_right(m, t) for m, t in received if m.state == STATE_LOCALIZED)
    assert all(m.state == STATE_LOCALIZED for m, _ in [*received[5:40], *received[90:]])


def test_wheels_that_slip_do_not_lose_the_robot(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf
) -> None:
    """Odometry reports forward while the robot goes back: what the scans show nearby takes over."""
    core, rng = make_core(), np.random.default_rng(9)
    truth, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
    wrong_for = 0
    for scan in range(80):
        time = 10.0 + 0.1 * scan
        slipping = 30 <= scan < 50
        truth = compose(truth, -STEP if slipping else STEP)
        odometry = compose(odometry, STEP)
        core.handle(speaker.odometry(time, odometry))
        seen = truth + rng.normal(size=3) * [0.03, 0.03, 0.01]
        message = poses_of(core.handle(speaker.hypotheses(time, [seen, *others(rng, 3)], [16.0, 7, 7, 7])))[0]
        wrong_for += message.state == STATE_LOCALIZED and not is_right(message, truth)
    assert wrong_for == 0
    assert message.state == STATE_LOCALIZED


@pytest.mark.parametrize("metres", [1.0, 2.0, 4.0])
def test_between_sparse_scans_wheels_slip_and_the_next_lists_show(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, metres: float
) -> None:
    """That the robot was right metres ago is no word on the way since: two metres show where it is."""
    core, rng = make_core(), np.random.default_rng(12)
    truth, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
    step = np.array([metres, 0.0, 0.3])
    for scan in range(20):
        time = 10.0 + metres * scan
        truth, odometry = compose(truth, step), compose(odometry, step)
        if scan == 10:
            odometry = compose(odometry, np.array([0.4 * metres, 0.4, 0.1]))
        core.handle(speaker.odometry(time, odometry))
        poses = [truth + rng.normal(size=3) * [0.03, 0.03, 0.01], *others(rng, 4)]
        message = poses_of(core.handle(speaker.hypotheses(time, poses, [18.0, 9.0, 9.0, 8.0, 8.0])))[0]
        assert message.state != STATE_LOCALIZED or is_right(message, truth)
        assert message.state == STATE_LOCALIZED or scan < 3 or 0 <= scan - 10 < 2.0 / metres


def test_off_the_map_the_claim_ends(make_core: MakeCore, speaker: Speaker, poses_of: PosesOf) -> None:
    core, rng = make_core(), np.random.default_rng(10)
    received = drive(core, speaker, poses_of, scans=30)
    assert received[-1][0].state == STATE_LOCALIZED
    states, odometry = [], np.zeros(3)
    for scan in range(400):
        time = 103.0 + 0.1 * (scan + 1)
        odometry = compose(odometry, STEP)
        core.handle(speaker.odometry(time, odometry))
        output = core.handle(speaker.hypotheses(time, others(rng, 5), 5.0 + rng.normal(size=5)))
        states += [m.state for m in poses_of(output)]
    # twenty metres
    assert states[-1] == STATE_LOST
    assert STATE_LOCALIZED not in states[300:]


def test_two_projectors_share_a_site(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, tracks_of: TracksOf
) -> None:
    """One searches the half where the robot is, the other what merely looks alike: both lists are of use."""
    core, rng = make_core(), np.random.default_rng(11)
    speaker.clutter = 0
    truth, odometry = np.array([2.0, 3.0, 0.0]), np.zeros(3)
    alias = np.array([25.0, 12.0, 1.0])
    for scan in range(60):
        time = 10.0 + 0.1 * scan
        truth, odometry, alias = (compose(pose, STEP) for pose in (truth, odometry, alias))
        core.handle(speaker.odometry(time, odometry))
        output = [
            *core.handle(speaker.hypotheses(time, [truth, *others(rng, 3)], [14.0, 7, 6, 5], projector="0")),
            *core.handle(speaker.hypotheses(time, [alias, *others(rng, 3)], [10.0, 7, 6, 5], projector="1")),
        ]
        # that the second list lacks the robot's place is no news of it
        last = poses_of(output)[-1]
        assert last.state == STATE_LOCALIZED
        assert is_right(last, truth)
        assert last.confidence > 0.89


def test_what_one_lidar_cannot_show_is_hidden_from_it_alone() -> None:
    belief, at = Belief(TrackerSettings()), np.array([[2.0, 3.0, 0.0]])
    for scan in range(12):
        for lidar in ("front", "rear"):
            poses = at if lidar == "front" or scan < 4 else at[:0]
            spread = np.tile(np.diag([1e-3, 1e-3, 1e-4]), (len(poses), 1, 1))
            likelihoods = np.full(len(poses), 14.0)
            seen = Observation(scan, f"{lidar}/0", lidar, "map", poses, spread, likelihoods, 0.0, 400.0, True)
            belief.observe(seen, Share(1.0, 1.0, 1.0))
            settle(belief)
    front, rear = belief.tracks.hidden[np.argmax(belief.tracks.log_weight)]
    assert front < 0.01
    assert rear > 0.99


PLACES = np.array([[2.0, 3.0, 0.0], [9.0, 7.0, 2.0]])


def first_lists(*lists: tuple[str, list[float]]) -> Belief:
    """What is believed after a lidar's first list, and another's: of each the likelihoods of PLACES."""
    belief = Belief(TrackerSettings())
    for lidar, found in lists:
        spread = np.tile(np.diag([1e-3, 1e-3, 1e-4]), (len(found), 1, 1))
        poses, likelihoods = PLACES[: len(found)], np.array(found)
        seen = Observation(0, f"{lidar}/0", lidar, "map", poses, spread, likelihoods, 0.0, 400.0, True)
        belief.observe(seen, Share(1.0, 0.0, 1.0, first=True))
        settle(belief)
    return belief


@given(st.lists(st.floats(16.0, 20.0), min_size=4, max_size=4))  # of more, one is too unlikely to be kept
def test_it_does_not_matter_which_lidar_was_first(found: list[float]) -> None:
    front, rear = ("front", found[:2]), ("rear", found[2:])
    odds = []
    for lists in ((front, rear), (rear, front)):
        tracks = first_lists(*lists).tracks
        masses = [tracks.log_weight[np.hypot(*(tracks.x - at)[:, :2].T) < 0.5].max() for at in PLACES]
        odds.append(masses[0] - masses[1])
    assert odds[0] == pytest.approx(odds[1], abs=1e-5)


def test_what_one_lidar_shows_may_be_hidden_from_another_from_the_start() -> None:
    belief = first_lists(("front", [18.0]), ("rear", []))
    before = first_lists(("front", [18.0]))
    lost = before.tracks.log_weight[0] - belief.tracks.log_weight[0]
    lost += np.log(belief.none_probability / before.none_probability)
    assert 0.0 < lost < -math.log(HIDES / (HIDES + SHOWS))


@given(st.floats(0.02, 0.5), st.floats(0.02, 0.5))
def test_a_first_list_leaves_the_odds_that_the_robot_is_off_the_map(one: float, other: float) -> None:
    place, spread = np.array([[2.0, 3.0, 0.0]]), np.diag([1e-3, 1e-3, 1e-4])[None]
    seen = Observation(0, "front/0", "front", "map", place, spread, np.array([14.0]), 0.0, 400.0, True)
    odds = []
    for share in (one, other):
        belief = Belief(TrackerSettings(), off_map_share=share)
        belief.observe(seen, Share(1.0, 1.0, 1.0))
        odds.append(belief.elsewhere.log_weight[0] - belief.tracks.log_weight[0] - logit(share))
    assert odds[0] == pytest.approx(odds[1], abs=1e-9)


@pytest.mark.parametrize("last", [9.5, 6.0, -40.0])
def test_a_cut_list_speaks_little_against_what_may_be_as_likely_as_its_last(last: float) -> None:
    """In a building of many rooms alike the right one is left out of one list of 30 in four."""
    place, spread = np.array([[2.0, 3.0, 0.0]]), np.diag([1e-3, 1e-3, 1e-4])[None]
    first = Observation(0, "a/0", "a", "map", place, spread, np.array([14.0]), 0.0, 400.0, True)
    masses = {}
    for cut in (False, True):
        later = replace(
            first,
            poses=np.array([[9.0, 3.0, 0.0], [14.0, 3.0, 1.0]]),
            covariances=np.tile(spread, (2, 1, 1)),
            log_likelihoods=np.array([10.0, last]),
            unlisted=-50.0,
            cut=cut,
        )
        belief = Belief(TrackerSettings())
        belief.observe(first, Share(1.0, 1.0, 1.0))
        belief.observe(later, Share(1.0, 1.0, 1.0))
        near = np.hypot(*(belief.tracks.x - place)[:, :2].T) < 0.5
        masses[cut] = np.exp(belief.tracks.log_weight[near]).sum() / belief.none_probability
    if last < -5.0:
        assert masses[True] == pytest.approx(masses[False])
    else:
        assert masses[True] > 1.2 * masses[False]


@given(st.floats(0.0, 1.0), st.integers(1, 40))
def test_what_lists_leave_out_is_less_and_less_on_the_map(progress: float, lists: int) -> None:
    """Against the sum over when the place would have been listed first, list by list."""
    belief, none = Belief(TrackerSettings()), np.zeros(0)
    seen = Observation(0, "a/0", "a", "map", np.zeros((0, 3)), np.zeros((0, 3, 3)), none, 0.0, 400.0, True)
    belief.observe(seen, Share(1.0, 1.0, 1.0))
    before = belief.elsewhere.log_weight[1] - belief.elsewhere.log_weight[0]
    left_out = 1.0
    for k in range(lists):
        belief.observe(seen, Share(1.0, progress, 1.0))
        emerging = (1.0 - MISSES ** (k + 1)) * left_out * -math.expm1(-EMERGES * progress)
        left_out -= emerging * -math.expm1(SHOWN_YET_MISSED)
    after = belief.elsewhere.log_weight[1] - belief.elsewhere.log_weight[0]
    assert after - before == pytest.approx(math.log(left_out), abs=1e-9)


@given(st.floats(1e-9, 0.5), st.floats(1e-9, 0.5))
def test_the_more_of_the_building_a_map_lacks_the_longer_lists_leave_a_robot_out(
    one: float, other: float
) -> None:
    mapped, lacking = emerges(min(one, other)), emerges(max(one, other))
    assert SHOWS < lacking <= mapped <= EMERGES


def test_a_lidar_that_sees_all_around_learns_nothing_by_a_turn(make_core: MakeCore, speaker: Speaker) -> None:
    """Another one does: its beams come to where they were not yet."""
    probability = {}
    for beams in (90, 180):
        core, speaker.clutter = make_core(), 0
        for scan in range(40):
            place = np.array([2.0, 3.0, 0.1 * scan])
            core.handle(speaker.odometry(0.1 * scan, np.array([0.0, 0.0, 0.1 * scan])))
            poses = [place, compose(place, np.array([9.0, 0.0, 0.0]))]
            output = core.handle(speaker.hypotheses(0.1 * scan, poses, [11.0, 9.0], used_beams=beams))
        (tracks,) = (each.open(Tracks) for each in output if each.channel is TRACKS)
        probability[beams] = max(track.probability for track in tracks.tracks)
    assert probability[180] < probability[90] - 0.02


def test_of_two_lidars_that_contradict_each_other_the_new_place_does_not_win() -> None:
    """The old place may look alike for one lidar and be hidden from the other, as the new one may."""
    belief, spread = Belief(TrackerSettings()), np.diag([1e-3, 1e-3, 1e-4])[None]
    here, new = (np.array([[2.0, 3.0, 0.0]]), 10.0), (np.array([[10.0, 3.0, 0.0]]), 13.0)
    for scan in range(120):
        for lidar in ("front", "rear"):
            pose, likelihood = new if lidar == "rear" and scan >= 40 else here
            likelihoods = np.array([likelihood])
            seen = Observation(scan, f"{lidar}/0", lidar, "map", pose, spread, likelihoods, 6.0, 400.0, True)
            belief.observe(seen, Share(0.23, 0.07, 0.2))
            settle(belief)
    stayed = np.hypot(*(belief.tracks.x[:, :2] - here[0][0, :2]).T) < 0.5
    assert np.exp(belief.tracks.log_weight[stayed]).sum() > 0.9


@pytest.mark.parametrize("seed", range(4))
def test_places_alike_along_a_hallway_do_not_pull_a_track_along(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, seed: int
) -> None:
    """Each scan fits sharply in many places along it; odometry, which is exact here, knows the way along."""
    core, rng, off = make_core(), np.random.default_rng(seed), list[float]()
    for scan in range(100):
        time, pose = 10.0 + 0.1 * scan, np.array([0.1 * scan, 0.0, 0.0])
        list(core.handle(speaker.odometry(time, pose)))
        in_hallway = scan >= 30
        along = rng.uniform(-3.0, 3.0, 8) if in_hallway else np.zeros(1)
        likelihoods = rng.uniform(10.0, 12.0, 8) if in_hallway else np.full(1, 17.0)
        places = pose + np.column_stack([along, np.zeros((len(along), 2))])
        (message,) = poses_of(core.handle(speaker.hypotheses(time, places, likelihoods)))
        off.append(message.pose.x - pose[0])
    assert np.abs(off[30:]).max() < 0.15


@pytest.mark.parametrize("beside", [(0.15, 0.0, 0.05), (0.0, 0.2, 0.0), (0.25, 0.0, 0.0)])
def test_what_each_scan_from_one_place_shows_far_off_makes_a_track_no_vaguer(
    make_core: MakeCore, speaker: Speaker, poses_of: PosesOf, beside: tuple[float, float, float]
) -> None:
    """A robot stands; every other list names a pose at the edge of its gate alone, ten times a second."""
    core, at = make_core(), np.array([2.0, 3.0, 0.0])
    sigmas = list[tuple[float, float]]()
    for scan in range(60):
        time = 10.0 + 0.05 * scan
        list(core.handle(speaker.odometry(time, np.zeros(3))))
        pose, log = (at + np.array(beside), 11.0) if scan % 2 else (at, 17.0)
        (message,) = poses_of(core.handle(speaker.hypotheses(time, [pose], [log])))
        sigmas.append((message.covariance.xx**0.5, message.covariance.tt**0.5))
    assert np.max(sigmas, axis=0) == pytest.approx(sigmas[0], rel=0.02)
