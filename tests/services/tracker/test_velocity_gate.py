"""The gate beside filterpy's Kalman filter, which takes a second to import and so is not in the service."""

import filterpy.stats
import numpy as np
import pytest
from eigenscan.tracker.velocity_gate import GATE, Reading, VelocityGate
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2

# written out, not taken from what is tested: a change there must show here
ACCELERATION = (3.0, 1.0, 6.0)
STEP_NOISE = (0.01, 0.01, 0.01)


def oracle_readings(steps: np.ndarray, seconds: np.ndarray) -> list[Reading]:
    """What filterpy computes for increments after the first, none of which is refused."""
    kalman = KalmanFilter(dim_x=3, dim_z=3)
    kalman.F = kalman.H = np.eye(3)
    kalman.x, kalman.P = steps[0] / seconds[0], np.diag((np.array(STEP_NOISE) / seconds[0]) ** 2)
    readings = []
    for step, dt in zip(steps[1:], seconds[1:], strict=True):
        noise = np.diag((np.array(STEP_NOISE) / dt) ** 2)
        kalman.predict(Q=np.diag((np.array(ACCELERATION) * dt) ** 2))
        distance = filterpy.stats.mahalanobis(step / dt, kalman.x, kalman.P + noise)
        inside = distance**2 <= chi2.ppf(1.0 - 1e-6, 3)
        readings.append(Reading.TAKEN if inside else Reading.SLIP)
        if not inside:
            break
        kalman.update(step / dt, R=noise)
    return readings


@given(st.integers(0, 10_000), st.floats(0.0, 0.1))
def test_it_takes_what_filterpys_gate_takes(seed: int, jitter: float) -> None:
    rng = np.random.default_rng(seed)
    seconds = rng.uniform(0.02, 0.1, 40)
    steps = (
        np.array([0.5, 0.0, 0.2]) + rng.normal(size=(40, 3)) * jitter * np.arange(40)[:, None]
    ) * seconds[:, None]
    gate = VelocityGate(v_max=50.0, turn_max=50.0)
    assert gate.judge(tuple(steps[0]), seconds[0]) is Reading.TAKEN
    for step, dt, expected in zip(steps[1:], seconds[1:], oracle_readings(steps, seconds), strict=False):
        assert gate.judge(tuple(step), dt) is expected


def test_the_gate_is_one_in_a_million() -> None:
    assert chi2.sf(GATE, 3) == pytest.approx(1e-6)
