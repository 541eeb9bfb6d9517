"""Which tracks are one, and what the joined one holds."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from eigenscan.tracker.tracks import Tracks, begin, join
from eigenscan.tracker.unification import unify

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
