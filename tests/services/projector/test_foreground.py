"""Narrow things that stand free are distinguished from walls and furniture."""

import numpy as np
from eigenscan.projector.foreground import foreground

STEP = np.deg2rad(2.0)


def test_legs_stand_free_and_walls_do_not() -> None:
    ranges = np.full(90, 5.0, dtype=np.float32)
    ranges[20:25] = 1.5  # 0.26 m wide
    ranges[40:60] = 2.0  # 0.7 m is exceeded: a cupboard
    ranges[85:] = 1.0  # runs out of sight
    ranges[70:] += 0.2 * np.arange(20, dtype=np.float32)  # a slanted wall has no jump
    found = foreground(ranges, STEP)
    assert np.flatnonzero(found).tolist() == [20, 21, 22, 23, 24]


def test_empty_beams_are_the_farthest_background() -> None:
    ranges = np.full(90, np.inf, dtype=np.float32)
    ranges[30:33] = 2.0
    ranges[50:52] = np.nan
    assert np.flatnonzero(foreground(ranges, STEP)).tolist() == [30, 31, 32]


def test_a_doorway_is_no_thing() -> None:
    ranges = np.full(90, 2.0, dtype=np.float32)
    ranges[40:50] = 6.0
    assert not foreground(ranges, STEP).any()


def test_nothing_jumps_nothing_is_found() -> None:
    assert not foreground(np.full(5, 2.0, dtype=np.float32), STEP).any()
    assert not foreground(np.full(5, np.nan, dtype=np.float32), STEP).any()
