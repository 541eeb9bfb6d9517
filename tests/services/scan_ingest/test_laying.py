"""A scan is laid on another one by compiled code as it is in numpy."""

from __future__ import annotations

import math

import numpy as np
from eigenscan.ingest.laying import lay_compiled
from eigenscan.ingest.motion import lay, points_of
from hypothesis import given
from hypothesis import strategies as st

FIRST, STEP = -math.pi / 2, math.radians(0.5)


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(15, 361), st.booleans())
def test_a_scan_is_laid_on_another_one_as_in_numpy(seed: int, starts: int, beams: int, behind: bool) -> None:
    rng = np.random.default_rng(seed)
    mount = (*rng.normal(0.0, 0.3, 2).tolist(), float(rng.uniform(-math.pi, math.pi)))
    wall = 3.0 + np.cumsum(rng.normal(0.0, 0.05, beams)) + rng.choice([0.0, 2.0], beams, p=[0.9, 0.1])
    ranges = np.where(rng.random(beams) < 0.1, np.nan, np.maximum(wall, 0.3))
    first = FIRST + math.pi if behind else FIRST
    before, after = (
        points_of(ranges + rng.normal(0.0, 0.01, beams), first, STEP, mount, time) for time in (0, 1)
    )
    given = before, after.xy[after.ranged], rng.normal(0.0, 0.1, (starts, 3))
    for one, other in zip(lay(*given), lay_compiled(*given), strict=True):
        assert (one.explained, one.points) == (other.explained, other.points)
        np.testing.assert_allclose(one.delta, other.delta, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(one.information, other.information, rtol=1e-9, atol=1e-6)
