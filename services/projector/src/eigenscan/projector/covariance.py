"""How far a refined pose can be off."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.surfaces import POINT_SIGMA
from eigenscan.geometry.symmetric import inverse_each
from numpy.typing import NDArray

Array = NDArray[np.float64]

INDEPENDENCE = 0.25
"""Independent points per point: neighbours err alike."""
PRIOR = np.diag([0.25, 0.25, np.deg2rad(5.0)]) ** 2
"""Covariance along directions that the walls do not determine (along a hallway): that of the grid."""
_HELD = np.linalg.inv(PRIOR)
FLOOR = np.diag([0.03, 0.03, np.deg2rad(1.0)]) ** 2
"""No pose is surer than this: the map's own error."""


def pose_covariances(information: Array, inexactness: float = 0.0) -> Array:
    """Covariances (n, 3, 3) of poses from J'WJ (n, 3, 3) of their points' distances.

    `inexactness`, m: standard deviation of a wall's surface from its assumed place.
    """
    certain = information * (INDEPENDENCE / (POINT_SIGMA**2 + inexactness**2))
    covariances: Array = inverse_each(certain + _HELD)
    covariances += FLOOR
    return covariances
