"""A refined pose's covariance, by what its points hold."""

import numpy as np
import pytest
from eigenscan.projector.covariance import pose_covariances

MAPS_OWN_M = 0.03
"""m: no pose is surer than the map is true."""


@pytest.mark.parametrize("points", [4, 400, 40_000])
def test_a_wall_ahead_holds_the_pose_by_its_independent_points(points: int) -> None:
    """Points of 5 cm, every fourth independent, on a wall across x; along y and in heading nothing holds."""
    information = np.diag([float(points), 0.0, 0.0])[None]
    (found,) = pose_covariances(information)
    by_points = 0.05**2 / (points / 4)
    by_grid = 0.25**2
    assert found[0, 0] == pytest.approx(1 / (1 / by_points + 1 / by_grid) + MAPS_OWN_M**2)
    assert found[1, 1] == pytest.approx(by_grid + MAPS_OWN_M**2)
    assert np.rad2deg(np.sqrt(found[2, 2])) == pytest.approx(np.hypot(5.0, 1.0))
