"""How probable a motion of the scans is."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.tracker.scan_motion import log_gaussian
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal


@given(st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3))
def test_densities_are_gaussian(off: list[float]) -> None:
    x, y, turn = off
    got = log_gaussian(x, y, turn, (0.02, 0.005, 0.03), 0.001, 0.1, 0.2)
    C = [[0.03, 0.005, 0], [0.005, 0.04, 0], [0, 0, 0.041]]
    assert got == pytest.approx(multivariate_normal.logpdf(off, np.zeros(3), C), rel=1e-9)
