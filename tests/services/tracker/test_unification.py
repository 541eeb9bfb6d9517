"""Which tracks are one, and what the joined one holds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from eigenscan.tracker.covariance import mahalanobis_squared, moments, residual
from eigenscan.tracker.tracks import Tracks, begin, join, replace
from eigenscan.tracker.unification import SAME_DISTANCE2, unify

HERE = np.array([[2.0, 3.0, 0.5]])
SURE = np.diag([0.01, 0.01, 0.001])[None]


def _track(mass: float, frame: int = 0, off: float = 0.0) -> Tracks:
    none = np.zeros(1)
    return begin(
        HERE + np.array([off, 0.0, 0.0]), SURE.copy(), np.log([mass]), none, np.zeros((1, 1)), frame, 0
    )


def _unified(*tracks: Tracks) -> Tracks:
    belief = SimpleNamespace(tracks=join(list(tracks)), stamp=0)
    unify(belief)  # type: ignore[arg-type]
    return belief.tracks


def test_two_tracks_of_one_place_become_one_with_the_mass_of_both() -> None:
    joined = _unified(_track(0.6), _track(0.3, off=0.02))
    assert np.exp(joined.log_weight) == pytest.approx([0.9])
    assert joined.x[0, 0] == pytest.approx((0.6 * 2.0 + 0.3 * 2.02) / 0.9)


def test_the_same_coordinates_on_two_floors_are_two_places() -> None:
    apart = _unified(_track(0.6, frame=0), _track(0.3, frame=1))
    assert apart.frame.tolist() == [0, 1]
    assert np.exp(apart.log_weight) == pytest.approx([0.6, 0.3])


def test_tracks_that_are_apart_stay_apart() -> None:
    assert len(_unified(_track(0.6), _track(0.3, off=1.0))) == 2


def _crowd(rng: np.random.Generator, count: int) -> Tracks:
    """Tracks around few places, heaviest first, some of them without a name."""
    spots = rng.uniform(-1.0, 1.0, (4, 3))
    root = rng.normal(size=(count, 3, 3)) * 0.05
    tracks = begin(
        spots[rng.integers(4, size=count)] + rng.normal(size=(count, 3)) * 0.05,
        root @ root.swapaxes(1, 2) + np.eye(3) * 1e-3,
        np.sort(rng.normal(-5.0, 3.0, count))[::-1].copy(),
        rng.uniform(0.0, 0.1, count),
        rng.normal(size=(count, 2)),
        1,
        7,
    )
    return replace(
        tracks,
        hidden=rng.uniform(size=count),
        frame=rng.integers(2, size=count),
        id=rng.integers(0, 2, count) * np.arange(count),
        parent=rng.integers(9, size=count),
        born=rng.integers(9, size=count),
        observations=rng.integers(9, size=count),
    )


def _groups(tracks: Tracks) -> list[np.ndarray]:
    """Greedy: the heaviest track takes all near it that are still free, then the next one."""
    off = residual(tracks.x[:, None], tracks.x[None])
    near = mahalanobis_squared(off, tracks.C[:, None] + tracks.C[None]) <= SAME_DISTANCE2
    near &= tracks.frame[:, None] == tracks.frame
    free, groups = np.ones(len(tracks), dtype=bool), []
    for leader in range(len(tracks)):
        if free[leader]:
            groups.append(np.flatnonzero(near[leader] & free))
            free[groups[-1]] = False
    return groups


@pytest.mark.parametrize("seed", range(20))
def test_the_compiled_form_is_the_readable_one(seed: int) -> None:
    tracks = _crowd(np.random.default_rng(seed), 30)
    belief = SimpleNamespace(tracks=tracks, stamp=99)
    unify(belief)  # type: ignore[arg-type]
    found, groups = belief.tracks, _groups(tracks)
    assert 4 <= len(groups) == len(found) < 30
    for row, group in enumerate(groups):
        weight = np.exp(tracks.log_weight[group])
        shown = weight * (1.0 - tracks.hidden[group])
        expected = {
            "log_weight": np.log(weight.sum()),
            "hidden": weight @ tracks.hidden[group] / weight.sum(),
            "alias": tracks.alias[group].sum(),
            "evidence": shown @ tracks.evidence[group] / shown.sum(),
            "frame": tracks.frame[group[0]],
            "fixed_at": 99 if len(group) > 1 else tracks.fixed_at[group[0]],
        }
        expected["x"], expected["C"] = moments(tracks.x[group], tracks.C[group], weight)
        if len(group) == 1:
            expected["x"], expected["C"] = tracks.x[group[0]], tracks.C[group[0]]
        named = group[tracks.id[group] > 0]
        heaviest = named[0] if len(named) and len(group) > 1 else group[0]
        for name in ("id", "parent", "born"):
            expected[name] = getattr(tracks, name)[heaviest]
        for name, value in expected.items():
            assert getattr(found, name)[row] == pytest.approx(value, rel=1e-12, abs=1e-12), name
