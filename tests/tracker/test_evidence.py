"""What a scan says of a track, against formulas written out."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.tracker.association import associate
from eigenscan.tracker.evidence import (
    MOST_AHEAD,
    SLIP_M,
    SLIP_RAD,
    SLIP_SHARE,
    SLIPS,
    Merit,
    hide_and_show,
    present_evidence,
    slipped_density,
    surprise,
)
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.tracks import Tracks, begin, join
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

R = np.diag([0.05, 0.05, 0.02]) ** 2


def listed(poses, log_likelihoods) -> Observation:
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


def track(pose, *, mass: float = 1.0, way: float = 0.0, turn: float = 0.0, evidence: float = 0.0) -> Tracks:
    begun = begin(np.array([pose], dtype=np.float64), R[None], np.log([mass]), np.array([[evidence]]), 1, 0)
    return Tracks(**{**vars(begun), "unchecked": np.array([[way, turn]])})


def test_the_best_is_worth_what_it_is_ahead_of_other_places() -> None:
    seen = listed([[1, 1, 0], [1.2, 1, 0.05], [6, 1, 0], [6, 4, 0]], [15.0, 14.0, 12.0, 11.0])
    merit = Merit.of(seen)
    # its neighbour is of the same place, and ahead of the next one by less
    np.testing.assert_allclose(merit.alone, [15.0 + 3.0, 14.0 + 2.0, 12.0, 11.0])
    lone = merit.foretold - Merit.of(listed(seen.poses[2:3], [12.0])).foretold[0]
    assert lone[3] < lone[2] < lone[0]


def test_a_lead_counts_up_to_a_bound_and_headings_wrap() -> None:
    far_ahead = Merit.of(listed([[1, 1, np.pi - 0.01], [1, 1, -np.pi + 0.01], [9, 9, 0]], [30.0, 29.0, 2.0]))
    np.testing.assert_allclose(far_ahead.alone, [30.0 + MOST_AHEAD, 29.0 + MOST_AHEAD, 2.0])


def test_an_empty_list_is_worth_nothing() -> None:
    assert len(Merit.of(listed(np.zeros((0, 3)), [])).alone) == 0


def test_a_vague_track_learns_no_more_than_the_scan_alone_tells() -> None:
    seen = listed([[1.0, 1.0, 0.0]], [12.0])
    sharp, vague = R[None] / 4, R[None] * 1e6
    merit = Merit.of(seen)
    for C, bound in ((sharp, merit.foretold[0]), (vague, merit.alone[0] - np.log(1e6 + 1.0) * 1.5)):
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


def test_slip_density_is_a_wide_gaussian_about_each_track() -> None:
    tracks = join([track([2, 3, 0.5], mass=0.6, way=1.5, turn=0.4), track([8, 1, -3.1], mass=0.4)])
    poses = np.array([[2.8, 2.7, 0.9], [7.9, 1.1, 3.1]])
    expected = np.zeros(2)
    for x, mass, way, turn in (([2, 3, 0.5], 0.6, 1.5, 0.4), ([8, 1, -3.1], 0.4, 0.0, 0.0)):
        sigma = np.array([SLIP_M, SLIP_M, SLIP_RAD]) + SLIP_SHARE * np.array([way, way, turn])
        off = poses - x
        off[:, 2] = np.angle(np.exp(1j * off[:, 2]))
        expected += SLIPS * mass * multivariate_normal(np.zeros(3), R + R + np.diag(sigma**2)).pdf(off)
    found = slipped_density(tracks, poses, np.tile(R, (2, 1, 1)))
    np.testing.assert_allclose(found, np.log(expected), rtol=1e-9)


def test_who_is_shown_here_has_not_slipped_here() -> None:
    pose, there = [2.0, 3.0, 0.5], np.array([[2.3, 3.0, 0.5]])
    shown = slipped_density(track(pose, evidence=5.0), there, R[None])
    hidden = slipped_density(track(pose, evidence=-5.0), there, R[None])
    assert hidden[0] - shown[0] == pytest.approx(5.0)
    np.testing.assert_allclose(present_evidence(track(pose, evidence=-5.0)), [0.0])


def test_without_tracks_nothing_slips() -> None:
    none = track([0, 0, 0]).pick(np.zeros(0, dtype=np.intp))
    assert slipped_density(none, np.zeros((2, 3)), np.tile(R, (2, 1, 1))).tolist() == [-np.inf, -np.inf]


def test_a_usual_innovation_leaves_the_covariance_as_it_is() -> None:
    np.testing.assert_allclose(surprise(np.array([0.0, 3.0, 15.0])), [1.0, 1.0, 3.0])
