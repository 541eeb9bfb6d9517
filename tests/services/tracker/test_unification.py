"""Which tracks are one, and what the joined one holds."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.reckoning import Leg, correct
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import moments_of
from eigenscan.tracker.tracks import Tracks, begin, join, replace
from eigenscan.tracker.unification import settle

from tests.services.tracker.readable import places, where_fixed

HERE = np.array([[2.0, 3.0, 0.5]])
SURE = np.diag([0.01, 0.01, 0.001])[None]


def _track(mass: float, frame: int = 0, off: float = 0.0) -> Tracks:
    none = np.zeros(1)
    return begin(
        HERE + np.array([off, 0.0, 0.0]), SURE.copy(), np.log([mass]), none, np.zeros((1, 1)), frame, 0
    )


def _unified(*tracks: Tracks) -> Tracks:
    return _settled(join(list(tracks))).tracks


def _settled(tracks: Tracks) -> Belief:
    """What no track holds is all mass that there is beside them."""
    none = 1.0 - np.exp(tracks.log_weight).sum()
    belief = Belief(TrackerSettings(), tracks, next_id=100)
    belief.elsewhere.log_weight[:] = np.log(none)
    settle(belief)
    return belief


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


def test_scan_motion_still_corrects_a_track_that_a_fork_joined() -> None:
    """Else what odometry may be off by since the last fix would stay, with each fork a little more."""
    vague = SURE + np.diag([0.02, 0.02, 0.02])
    main = replace(
        _track(0.9),
        fixed_x=HERE - [0.5 * np.cos(0.5), 0.5 * np.sin(0.5), 0.0],
        C=vague,
        fixed_at=np.array([10]),
    )
    joined = _unified(main, replace(_track(0.05, off=0.02), fixed_at=np.array([99])))
    way = Leg(10, 99, (0.45, 0.0, 0.0), 1e-6 * np.eye(3), (-0.05, 0.0, 0.0))
    stood = Motion((0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    corrected = correct(joined, way, 99, lambda *_: stood, TrackerSettings())
    assert len(joined) == 1
    assert joined.C[0, 2, 2] > 0.01
    assert corrected.C[0, 2, 2] == pytest.approx(0.001, rel=0.01)
    assert corrected.x[0, :2] == pytest.approx(
        HERE[0, :2] - 0.05 * np.array([np.cos(0.5), np.sin(0.5)]), abs=0.01
    )


def _crowd(rng: np.random.Generator, count: int) -> Tracks:
    """Tracks around few places, heaviest first, some of them without a name."""
    spots = rng.uniform(-1.0, 1.0, (4, 3))
    root = rng.normal(size=(count, 3, 3)) * 0.05
    tracks = begin(
        spots[rng.integers(4, size=count)] + rng.normal(size=(count, 3)) * 0.05,
        root @ root.swapaxes(1, 2) + np.eye(3) * 1e-3,
        np.sort(np.log(0.9 * rng.dirichlet(np.full(count, 0.5)) + 1e-6))[::-1].copy(),
        rng.uniform(0.0, 0.1, count),
        rng.normal(size=(count, 2)),
        1,
        7,
    )
    return replace(
        tracks,
        hidden=rng.uniform(size=(count, 2)),
        frame=rng.integers(2, size=count),
        id=rng.integers(0, 2, count) * np.arange(count),
        parent=rng.integers(9, size=count),
        born=rng.integers(9, size=count),
        observations=rng.integers(9, size=count),
        fixed_x=tracks.x + rng.normal(size=(count, 3)) * 0.2,
        fixed_covariance=tracks.C + np.eye(3) * 1e-3,
        fixed_at=rng.integers(3, size=count),
    )


@pytest.mark.parametrize("seed", range(20))
def test_the_compiled_form_is_the_readable_one(seed: int) -> None:
    tracks = _crowd(np.random.default_rng(seed), 30)
    belief, groups = _settled(tracks), places(tracks)
    found = belief.tracks
    assert 4 <= len(groups) == len(found) < 30
    next_id = 100
    for row, group in enumerate(groups):
        weight = np.exp(tracks.log_weight[group])
        shown = weight[:, None] * (1.0 - tracks.hidden[group])
        expected = {
            "log_weight": np.log(weight.sum()),
            "hidden": weight @ tracks.hidden[group] / weight.sum(),
            "alias": tracks.alias[group].sum(axis=0),
            "evidence": (shown * tracks.evidence[group]).sum(axis=0) / shown.sum(axis=0),
            "frame": tracks.frame[group[0]],
            "fixed_at": tracks.fixed_at[group[0]],
        }
        expected["x"], expected["C"] = moments_of(tracks.x[group], tracks.C[group], weight)
        fixed = where_fixed(tracks.pick(group))
        expected["fixed_x"], expected["fixed_covariance"] = moments_of(*fixed, weight)
        if len(group) == 1:
            names = ("x", "C", "fixed_x", "fixed_covariance")
            expected |= {name: getattr(tracks, name)[group[0]] for name in names}
        named = group[tracks.id[group] > 0]
        heaviest = named[0] if len(named) else group[0]
        for name in ("id", "parent", "born"):
            expected[name] = getattr(tracks, name)[heaviest]
        if not len(named):
            expected["id"], next_id = next_id, next_id + 1
        for name, value in expected.items():
            assert getattr(found, name)[row] == pytest.approx(value, rel=1e-12, abs=1e-12), name
    assert belief.next_id == next_id
