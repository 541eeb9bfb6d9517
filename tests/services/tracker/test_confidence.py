"""Compiled confidence and protection levels beside the readable numpy form."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.tracker.confidence import (
    PLACE_M,
    PLACE_RAD,
    TAILS,
    Protection,
    judge,
    protect,
    share_within,
)
from eigenscan.tracker.covariance import residual
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD
from eigenscan.tracker.tracks import Tracks, begin
from scipy.special import ndtri
from scipy.stats import ncx2, norm


def crowd(rng: np.random.Generator, count: int) -> Tracks:
    """Tracks around one place and some elsewhere, of two frames, nearly all of the mass on the first few."""
    root = rng.normal(size=(count, 3, 3)) * 0.1
    x = np.array([3.0, -2.0, np.pi]) + rng.normal(size=(count, 3)) * [0.4, 0.4, 0.2]
    weight = 10.0 ** -rng.uniform(2.0, 6.0, count)
    weight[:3] += 0.4
    none = np.zeros(count)
    tracks = begin(x, root @ root.swapaxes(1, 2), np.log(weight / weight.sum()), none, none[:, None], 1, 0)
    tracks.frame[count // 2 :] = rng.integers(1, 3, count - count // 2)
    return tracks


def wide(C: np.ndarray) -> np.ndarray:
    return np.linalg.eigvalsh(C[:, :2, :2])[:, 1]


def readable(tracks: Tracks, best: int, risk: float) -> Protection | None:
    weight, delta = np.exp(tracks.log_weight), residual(tracks.x, tracks.x[best])
    off, turn = np.hypot(delta[:, 0], delta[:, 1]), np.abs(delta[:, 2])
    here = (tracks.frame == tracks.frame[best]) & (off <= PLACE_M) & (turn <= PLACE_RAD)
    left = risk - (1.0 - weight[here].sum())
    if left <= 0.0:
        return None
    order = np.flatnonzero(here)[np.argsort(weight[here], kind="stable")]
    kept = order[np.cumsum(weight[order]) > 0.25 * left]
    share = 0.375 * left
    radius = off[kept] + TAILS * np.sqrt(-2.0 * np.log(share) * wide(tracks.C[kept]))
    angle = turn[kept] - TAILS * ndtri(share / 2.0) * np.sqrt(tracks.C[kept, 2, 2])
    return Protection(float(radius.max()), float(angle.max()))


def test_the_compiled_protection_level_is_the_readable_one() -> None:
    levels = 0
    for seed in range(40):
        tracks = crowd(np.random.default_rng(seed), 12)
        for risk in (1e-3, 0.2, 0.45):
            found, expected = protect(tracks, 0, risk), readable(tracks, 0, risk)
            assert (found is None) == (expected is None)
            if found and expected:
                levels += 1
                assert found.radius == pytest.approx(expected.radius, rel=1e-12)
                assert found.angle == pytest.approx(expected.angle, rel=1e-12)
    assert levels > 20


def test_the_compiled_share_within_reach_is_the_readable_one() -> None:
    tracks = crowd(np.random.default_rng(1), 30)
    delta = residual(tracks.x, tracks.x[0])
    long_axis, sigma = wide(tracks.C), np.sqrt(tracks.C[:, 2, 2])
    position = ncx2.cdf(NEAR_M**2 / long_axis, 2, (delta[:, :2] ** 2).sum(axis=1) / long_axis)
    heading = norm.cdf(NEAR_RAD, delta[:, 2], sigma) - norm.cdf(-NEAR_RAD, delta[:, 2], sigma)
    assert share_within(delta, tracks.C) == pytest.approx(position * heading, abs=1e-9)


def test_the_most_believed_track_is_the_heaviest_of_those_with_most_mass_of_their_frame_around() -> None:
    chosen, heavier = set(), 0
    for seed in range(40):
        tracks = crowd(np.random.default_rng(seed), 12)
        weight, masses = np.exp(tracks.log_weight), np.zeros(12)
        for i in range(12):
            same = tracks.frame == tracks.frame[i]
            masses[i] = (weight * same * share_within(residual(tracks.x, tracks.x[i]), tracks.C)).sum()
        verdict = judge(tracks)
        most = np.where(weight >= 0.25 * weight.max(), masses, -1.0)
        assert verdict.track == np.argmax(np.where(most >= most.max() - 0.05, weight, -1.0))
        heavier += bool(verdict.track != np.argmax(most))
        assert verdict.confidence == pytest.approx(min(masses[verdict.track], 1.0), rel=1e-12)
        chosen.add(verdict.track)
    assert len(chosen) == 3
    assert heavier
