"""How far a refined pose can be off."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.symmetric import inverse_each
from numpy.typing import NDArray

Array = NDArray[np.float64]

POINT_SIGMA = 0.05
"""m, error of a beam's end point about the map's wall."""
INDEPENDENCE = 0.25
"""Independent points per point: neighbours err alike."""
PRIOR = np.diag([0.25, 0.25, np.deg2rad(5.0)]) ** 2
"""Where the walls do not hold a pose (along a hallway), the grid that it started from does."""
_HELD = np.linalg.inv(PRIOR)
FLOOR = np.diag([0.03, 0.03, np.deg2rad(1.0)]) ** 2
"""No pose is surer than this: the map's own error."""


def pose_covariances(information: Array, inexactness: float = 0.0) -> Array:
    """Covariances (n, 3, 3) of poses from J'WJ (n, 3, 3) of their points' distances.

    `inexactness`, m: how far a wall's surface may be from where it is taken to be (standard deviation).
    """
    certain = information * (INDEPENDENCE / (POINT_SIGMA**2 + inexactness**2))
    covariances: Array = inverse_each(certain + _HELD)
    covariances += FLOOR
    return covariances
