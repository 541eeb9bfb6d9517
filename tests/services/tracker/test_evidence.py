"""What a scan shows of a track, against formulas written out; test_weighing.py has the compiled form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from eigenscan.geometry.circle import TURN, wrap
from eigenscan.geometry.pose import compose
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.tracker.association import Pairs
from eigenscan.tracker.evidence import likelihood_at
from eigenscan.tracker.observation import Observation, poorness
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.robot import _Source
from eigenscan.tracker.tracks import Tracks, begin, join
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.stats import multivariate_normal

from tests.services.tracker.conftest import MakeCore, Speaker, TracksOf
from tests.services.tracker.readable import (
    Merit,
    aliases_go_on,
    aliases_of,
    associate,
    explained_by_aliases,
    hide_and_show,
    present_evidence,
    share_aliases,
    slipped,
)

# written out, not taken from what is tested: a change there must show here
ENDS = 0.25
LEAD = 0.8
BEHIND = 0.4
TOGETHER = 0.4
MOST = 5.0
SLIP_M = 0.1
SLIP_RAD = 0.1
SLIP_SHARE = 1.0
SLIPS = 0.02
SLIPPED = 1.0 - np.exp(-SLIPS)
ALIASES = 0.02

R = np.diag([0.05, 0.05, 0.02]) ** 2


def listed(poses: np.ndarray | Sequence[Sequence[float]], log_likelihoods: ArrayLike) -> Observation:
    poses = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    return Observation(
        0,
        "front/0",
        "front",
        "map",
        poses,
        np.tile(R, (len(poses), 1, 1)),
        np.asarray(log_likelihoods, dtype=np.float64),
        0.0,
        400.0,
        True,
    )


def track(
    pose: ArrayLike, *, mass: float = 1.0, way: float = 0.0, turn: float = 0.0, evidence: float = 0.0
) -> Tracks:
    begun = begin(
        np.array([pose], dtype=np.float64), R[None], np.log([mass]), np.zeros(1), np.array([[evidence]]), 1, 0
    )
    return Tracks(**{**vars(begun), "unchecked": np.array([[way, turn, way, turn]])})


def test_the_best_is_worth_what_it_is_ahead_of_other_places() -> None:
    seen = listed([[1, 1, 0], [1.2, 1, 0.05], [6, 1, 0], [6, 4, 0]], [15.0, 14.0, 12.0, 11.0])
    merit = Merit.of(seen)
    # its neighbour is of the same place, and ahead of the next one by less
    np.testing.assert_allclose(merit.alone, [15.0 + 3.0, 14.0 + 2.0, 12.0, 11.0 - 1.5 * 0.25])
    # to a track that had predicted it: the others by what they are behind the best
    np.testing.assert_allclose(merit.predicted, [3.0 * LEAD, 2.0 * LEAD, -3.0 * BEHIND, -4.0 * BEHIND])


def test_two_equal_places_speak_together_against_a_track_that_is_not_listed() -> None:
    poses = [[3.0 * i, 0, 0] for i in range(8)]
    worth = Merit.of(listed(poses, [18.0, 18.0, *[6.0] * 6])).predicted
    # one of two is right
    np.testing.assert_allclose(worth[:2], TOGETHER * 12.0 - np.log(2.0))
    assert (worth[2:] < 0.0).all()


def test_places_that_fall_off_evenly_show_nothing_together() -> None:
    falling = 15.0 - 0.5 * np.arange(10)
    worth = Merit.of(listed([[3.0 * i, 0, 0] for i in range(10)], falling)).predicted
    np.testing.assert_allclose(worth, [0.5 * LEAD, *(-0.5 * BEHIND * np.arange(1, 10))])


@given(st.lists(st.floats(1.0, 30.0), min_size=2, max_size=12), st.floats(-10.0, 10.0))
def test_to_a_track_likelihoods_of_one_list_count_by_their_differences(
    found: list[float], more: float
) -> None:
    """An inexact map makes all places of a list less likely, and shows as well which is the right one."""
    poses = [[3.0 * number, 0.0, 0.0] for number in range(len(found))]
    one, other = (Merit.of(listed(poses, np.array(found) + 20.0 + add)).predicted for add in (0.0, more))
    np.testing.assert_allclose(one, other, atol=1e-9)
    assert np.all(np.abs(one) <= MOST)
    assert np.all(np.diff(one[np.argsort(-np.array(found), kind="stable")]) <= 1e-9)


def test_a_lead_counts_up_to_a_bound_and_headings_wrap() -> None:
    far_ahead = Merit.of(listed([[1, 1, np.pi - 0.01], [1, 1, -np.pi + 0.01], [9, 9, 0]], [30.0, 29.0, 2.0]))
    # a poor fit's covariance is exp(0.25 * 10) times as large: its volume by 1.5 times as many nats
    np.testing.assert_allclose(far_ahead.alone, [30.0 + MOST, 29.0 + MOST, 2.0 - 1.5 * 2.5])


def test_a_poor_fit_errs_by_more_and_by_no_more_than_twenty_times() -> None:
    np.testing.assert_allclose(
        np.exp(poorness(np.array([20.0, 12.0, 8.0, 0.0, -300.0]))),
        [1.0, 1.0, np.exp(1.0), np.exp(3.0), np.exp(3.0)],
    )


def test_a_poor_fit_makes_its_place_no_likelier() -> None:
    for L in (3.0, 9.0, 14.0):
        wider = R * np.exp(poorness(np.array([L])))[0]
        mass = Merit.of(listed([[1, 1, 0]], [L])).alone[0] + 0.5 * np.log(np.linalg.det(wider))
        lead = min(L, MOST)
        assert mass == pytest.approx(L + lead + 0.5 * np.log(np.linalg.det(R)))


def test_an_empty_list_is_worth_nothing() -> None:
    assert len(Merit.of(listed(np.zeros((0, 3)), [])).alone) == 0


def test_a_vague_track_learns_no_more_than_the_scan_alone_shows() -> None:
    seen = listed([[1.0, 1.0, 0.0]], [12.0])
    sharp, vague = R[None] / 4, R[None] * 1e6
    merit = Merit.of(seen)
    for C, bound in ((sharp, merit.predicted[0]), (vague, merit.alone[0] - np.log(1e6 + 1.0) * 1.5)):
        pairs = associate(np.array([[1.0, 1.0, 0.0]]), C, seen.poses, seen.covariances, 16.0)
        assert merit.of_pairs(pairs)[0] == pytest.approx(bound, abs=1e-9)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1e4))
def test_hidden_shares_stay_shares(hidden: float, progress: float) -> None:
    after = float(hide_and_show(np.array([hidden]), progress)[0])
    assert 0.0 <= after <= 1.0
    if progress == 0.0:
        assert after == hidden


def test_hiding_in_small_steps_is_hiding_in_a_large_one() -> None:
    small = np.array([0.0])
    for _ in range(1000):
        small = hide_and_show(small, 1e-3)
    # the large step leaves out who hides and shows within it
    assert small[0] == pytest.approx(hide_and_show(np.array([0.0]), 1.0)[0], rel=0.15)


def within_gates(tracks: Tracks, seen: Observation, gate: float = 16.0) -> Pairs:
    return associate(tracks.x, tracks.C, seen.poses, seen.covariances, gate)


def test_slipped_mass_is_a_wide_gaussian_about_each_track() -> None:
    tracks = join([track([2, 3, 0.5], mass=0.6, way=1.5, turn=0.4), track([8, 1, -3.1], mass=0.4)])
    # so little speaks for them that what a scan alone shows is the less
    seen = listed([[3.8, 2.7, 0.9], [7.5, 1.1, 3.1]], [-8.0, -9.0])
    merit, expected = Merit.of(seen), np.zeros(2)
    for x, mass, way, turn in (([2, 3, 0.5], 0.6, 1.5, 0.4), ([8, 1, -3.1], 0.4, 0.0, 0.0)):
        sigma = np.array([SLIP_M, SLIP_M, SLIP_RAD]) + SLIP_SHARE * np.array([way, way, turn])
        off = seen.poses - x
        off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
        density = multivariate_normal(np.zeros(3), R + R + np.diag(sigma**2)).pdf(off)
        volume = np.sqrt((2.0 * np.pi) ** 3 * np.linalg.det(R))
        expected += (
            SLIPPED * mass * np.minimum(np.exp(merit.predicted), np.exp(merit.alone) * volume * density)
        )
    found = slipped(tracks, seen, merit, within_gates(tracks, seen))
    np.testing.assert_allclose(found, np.log(expected), rtol=1e-9)


def test_a_hypothesis_nearby_shows_no_more_of_a_slip_than_of_a_track() -> None:
    tracks, seen = track([2.0, 3.0, 0.5], way=0.5), listed([[2.4, 3.0, 0.5]], [40.0])
    merit = Merit.of(seen)
    found = slipped(tracks, seen, merit, within_gates(tracks, seen))
    assert found[0] == pytest.approx(np.log(SLIPPED) + merit.predicted[0])


def test_the_farther_a_robot_came_without_a_list_the_likelier_its_wheels_slipped() -> None:
    tracks, seen = track([2.0, 3.0, 0.5]), listed([[2.4, 3.0, 0.5]], [40.0])
    none = within_gates(track([9, 9, 0]), seen)
    stood, near, far, farther = (
        slipped(tracks, seen, Merit.of(seen), none, steps)[0] for steps in (0.0, 1.0, 10.0, 1e6)
    )
    assert stood == near
    assert far - near == pytest.approx(np.log(10.0), abs=0.1)
    assert farther - near == pytest.approx(-np.log(SLIPPED))  # no more than all of it


def test_a_track_has_not_slipped_to_what_is_in_its_gate() -> None:
    tracks, seen = join([track([2.0, 3.0, 0.5]), track([2.5, 3.0, 0.5])]), listed([[2.02, 3.0, 0.5]], [12.0])
    alone = slipped(tracks.pick(np.array([1])), seen, Merit.of(seen), within_gates(track([9, 9, 0]), seen))
    assert np.isfinite(alone[0])
    assert slipped(tracks, seen, Merit.of(seen), within_gates(tracks, seen))[0] == pytest.approx(alone[0])


def test_who_is_shown_here_has_not_slipped_here() -> None:
    pose, seen = [2.0, 3.0, 0.5], listed([[2.4, 3.0, 0.5]], [12.0])
    none = within_gates(track([9, 9, 0]), seen)
    shown = slipped(track(pose, evidence=5.0), seen, Merit.of(seen), none)
    hidden = slipped(track(pose, evidence=-5.0), seen, Merit.of(seen), none)
    assert hidden[0] - shown[0] == pytest.approx(5.0)
    np.testing.assert_allclose(present_evidence(track(pose, evidence=-5.0)), [0.0])


def test_without_tracks_nothing_slips() -> None:
    none, seen = track([0, 0, 0]).pick(np.zeros(0, dtype=np.intp)), listed(np.zeros((2, 3)), [9.0, 9.0])
    assert slipped(none, seen, Merit.of(seen), within_gates(none, seen)).tolist() == [-np.inf, -np.inf]


SHARES = st.floats(0.0, 1.0)


@given(st.lists(st.tuples(SHARES, st.floats(-12.0, 12.0), SHARES), min_size=1, max_size=6), SHARES)
def test_aliases_are_weighed_by_bayes(tracks: list[tuple[float, ...]], none: float) -> None:
    """Case by case: none of the tracks is an alias, or the first is, shown or hidden, and so on."""
    shares, gained, hidden = np.array(tracks).T
    prior = np.append(none + 0.01, shares)
    prior = prior / prior.sum()
    explained, of_others, after = explained_by_aliases(prior[1:], gained, hidden)
    joint = prior * np.append(1.0, hidden + (1.0 - hidden) * np.exp(gained))
    assert explained == pytest.approx(np.log(joint.sum()), abs=1e-9)
    np.testing.assert_allclose(after, joint[1:] / joint.sum(), atol=1e-9)
    for index, other in enumerate(of_others, start=1):
        if prior[index] < 0.99:
            rest = np.delete(joint, index).sum() / np.delete(prior, index).sum()
            assert other == pytest.approx(np.log(rest), abs=1e-6)


def test_a_similar_place_that_goes_on_gains_no_more_than_aliases_end() -> None:
    """What looked right at first shows little by looking right again, however well it does."""
    alias, reported = aliases_of(np.array([6.0])), []
    for _ in range(60):
        explained, _, alias = explained_by_aliases(aliases_go_on(alias, 1.0), np.array([6.0]), np.zeros(1))
        reported.append(6.0 - explained)
    # the share of aliases that end over a step is all that is left to learn
    assert reported[-1] == pytest.approx(ENDS, abs=0.005)
    assert max(reported[1:]) < 0.5


@given(SHARES, SHARES, st.floats(0.0, 1e3))
def test_aliases_are_one_at_most_and_in_the_end_as_many_as_usual(a: float, b: float, progress: float) -> None:
    pair, alias = join([track([0, 0, 0]), track([5, 0, 0])]), np.array([a, b])
    shared = share_aliases(Tracks(**{**vars(pair), "alias": alias})).alias
    after = aliases_go_on(shared, progress)
    for each in (shared, after):
        assert (each >= 0.0).all()
        assert each.sum() <= 1.0 + 1e-9
    np.testing.assert_allclose(aliases_go_on(np.zeros(2), 1e6), [ALIASES, ALIASES])
    # one that is sure to be an alias only ends
    np.testing.assert_allclose(aliases_go_on(np.ones(1), progress), np.exp(-ENDS * progress))


def test_two_places_that_look_the_same_stay_even_where_one_of_them_had_a_poor_track(
    make_core: MakeCore, speaker: Speaker, tracks_of: TracksOf
) -> None:
    """As behind the doors of a lift on one of two floors that are alike: the cabin left poor tracks."""
    core = make_core()
    turning = [np.array([0.0, 0.0, 0.12 * number]) for number in range(20)]
    cabin, poor = [np.array([20.0, 0.0, 0.0]), np.array([20.0, 40.0, 0.0])], np.array([0.0, 0.0, 0.0])
    for number, turn in enumerate(turning):
        core.handle(speaker.odometry(0.1 * number, turn))
        listed = [*(one + turn for one in cabin), poor + turn]
        core.handle(speaker.hypotheses(0.1 * number, listed, [14.0, 14.0, 8.0]))
    out = turning[-1] + np.array([0.16, 0.1, 0.0])
    for number in range(20, 40):
        step = np.array([0.1 * (number - 20), 0.0, 0.0])
        core.handle(speaker.odometry(0.1 * number, compose(turning[-1], step)))
        here, there = compose(poor + out, step), compose(poor + out + [0.0, 40.0, 0.0], step)
        output = core.handle(speaker.hypotheses(0.1 * number, [here, there], [22.0, 22.0]))
        (tracks,) = tracks_of(output)
        masses = [
            sum(t.probability for t in tracks.tracks if np.hypot(t.pose.x - x, t.pose.y - y) < 1.0)
            for x, y in (here[:2], there[:2])
        ]
        assert max(masses) < 2.0 * min(masses), (number, masses)
    assert sum(masses) > 0.9


def test_the_likelihood_at_a_pose_is_that_of_its_likeliest_hypothesis() -> None:
    seen = listed([[1.0, 1.0, 3.1], [1.2, 1.0, -3.1], [4.0, 1.0, 3.1]], [7.0, 8.0, 20.0])
    assert likelihood_at(np.array([1.0, 1.0, 3.1]), seen) == 8.0
    assert likelihood_at(np.array([8.0, 1.0, 3.1]), seen) == 0.0


def test_a_track_that_no_scan_chose_takes_its_first_hypothesis_as_a_place_does() -> None:
    seen = listed([[1.0, 1.0, 0.0]], [20.0])
    merit = Merit.of(seen)
    pairs = within_gates(track([1.0, 1.0, 0.0]), seen)
    assert merit.at_first(pairs, np.array([False])).tolist() == [0.0]
    more = merit.at_first(pairs, np.array([True]))
    np.testing.assert_allclose(merit.of_pairs(pairs) + more, merit.alone + pairs.log_overlap)


def test_after_a_whole_turn_a_place_has_shown_all_that_it_shows(
    make_core: MakeCore, speaker: Speaker
) -> None:
    def confidence(turns: float) -> float:
        """After 40 s at one place, of which the robot turned so many times at 1 rad/s."""
        core, published = make_core(), list[Envelope]()
        for time in np.arange(0.0, 40.0, 0.1).tolist():
            heading = float(wrap(min(time, turns * TURN)))
            published += core.handle(speaker.odometry(time, np.array([0.0, 0.0, heading])))
            published += core.handle(speaker.hypotheses(time, [[2.0, 3.0, heading]], [10.0]))
        return [each.open(PoseEstimate).confidence for each in published if each.channel is POSE][-1]

    assert confidence(6.0) <= confidence(1.0) + 0.05
    assert confidence(0.0) <= confidence(1.0)


def moved(way: float, turn: float) -> Motion:
    return Motion((way, 0.0, turn), way, turn, 0.0, 0.0, 0.0, 1.0)


@given(st.lists(st.floats(0.0, 2.0), max_size=40), st.floats(0.0, TURN))
def test_turns_at_one_place_count_until_all_of_it_was_seen(turns: list[float], unseen: float) -> None:
    source = _Source(0, ("front", "map"))
    counted = sum(source.new_turn(moved(0.0, turn), 0.5, unseen) for turn in turns)
    assert counted == pytest.approx(min(sum(turns), unseen))


def test_a_new_place_is_to_be_seen_all_around_again() -> None:
    source = _Source(0, ("front", "map"))
    source.new_turn(moved(0.0, 10.0), 0.5, TURN)
    assert source.new_turn(moved(5.0, 10.0), 0.5, TURN) == pytest.approx(TURN, rel=1e-3)
    assert source.new_turn(moved(0.0, 1.0), 0.5, 2.0) == 0.0  # less is unseen now: it was seen before
