"""What compiled code finds between two scans is what numpy finds."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from eigenscan.ingest.laying import eigen
from eigenscan.ingest.motion import motion_between, points_of
from hypothesis import given
from hypothesis import strategies as st
from numba import njit

from tests.services.scan_ingest import readable

FIRST, STEP = -math.pi / 2, math.radians(0.5)


@given(st.integers(0, 10_000), st.integers(10, 721), st.booleans(), st.booleans())
def test_the_motion_between_two_scans_is_that_of_numpy(
    seed: int, beams: int, behind: bool, is_hallway: bool
) -> None:
    rng = np.random.default_rng(seed)
    mount = (*rng.normal(0.0, 0.3, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    wall = 3.0 + np.cumsum(rng.normal(0.0, 0.05, beams)) + rng.choice([0.0, 2.0], beams, p=[0.9, 0.1])
    ranges = np.where(rng.random(beams) < 0.1, np.nan, np.maximum(wall, 0.3))
    first = FIRST + math.pi if behind else FIRST
    if is_hallway:
        ranges = np.minimum(1.2 / np.maximum(np.abs(np.sin(first + STEP * np.arange(beams))), 0.15), 8.0)
        ranges[ranges == 8.0] = np.inf
    # no point of the later scan lies just between what the earlier one's first beam sees and does not
    pair = [(rng.normal(0.0, 0.01, beams) + ranges, first + 0.3 * STEP * scan) for scan in (0, 1)]
    compiled, numpy = (
        [points(*each, STEP, mount, time) for time, each in enumerate(pair)]
        for points in (points_of, readable.points_of)
    )
    for one, other in zip(compiled, numpy, strict=True):
        for name in ("ranges", "xy", "normals", "ranged", "lined"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0.0, atol=1e-12)
    x, y, turn = rng.normal(0.0, 0.1, 3).tolist()
    found = motion_between(compiled[0], compiled[1], (x, y, turn))
    expected = readable.motion_between(numpy[0], numpy[1], (x, y, turn))
    assert (found.explained, found.points) == (expected.explained, expected.points)
    np.testing.assert_allclose(found.delta, expected.delta, rtol=0.0, atol=1e-9)
    largest = np.abs(expected.information).max()
    np.testing.assert_allclose(found.information, expected.information, rtol=0.0, atol=1e-9 * largest + 1e-9)


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e5])
def test_directions_are_those_of_numpy_also_in_sign(factor: float) -> None:
    compiled: Any = njit(eigen.py_func)  # type: ignore[attr-defined]
    rng = np.random.default_rng(1)
    for matrix in [*rng.normal(size=(200, 2, 2)), *rng.integers(-2, 3, (200, 2, 2)), np.zeros((2, 2))]:
        own = factor * matrix @ matrix.T
        values, directions = np.linalg.eigh(own)
        smaller, larger, *direction = compiled(own[0, 0], own[1, 0], own[1, 1])
        np.testing.assert_allclose([smaller, larger], values, rtol=1e-12, atol=1e-12 * factor)
        if values[1] - values[0] > 1e-9 * factor:
            np.testing.assert_allclose(direction, directions[:, 0], atol=1e-9)
