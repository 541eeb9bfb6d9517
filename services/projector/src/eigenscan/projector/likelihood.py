"""How much likelier a scan is at a pose than at a place that the map does not show.

A beam speaks for a pose where it ends on a wall, and against it where it went through one. A beam that ends
before its wall (a person, furniture) does neither. What the beams say is summed, less what they would say
of the best pose in a building that is not the map's, and weighed by how many of them are independent.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

WALL_SCALE = 0.15
"""m from a wall at which an end point counts half: noise, the map's resolution, rest of the pose's error."""
THROUGH_MARGIN = 0.3
"""m behind the predicted wall before a beam counts as having gone through it."""
THROUGH_WEIGHT = 0.8
"""What a beam through a wall says against a pose, in beams on a wall."""
STRANGE_SUPPORT = 0.45
"""Mean support a beam that the best pose in a foreign building reaches."""
NATS = 60.0
"""ln of the odds that a scan with full support gives over one with none."""


def support(seen: NDArray[np.float32], predicted: NDArray[np.float32], distance: Array) -> Array:
    """Mean support (n,) of beams (B,) for poses, at most 1.

    `seen` (B,) finite ranges, `predicted` (n, B) +inf where no wall is in sight, `distance` (n, B) of the end
    points from the nearest wall, all in m.
    """
    on_wall = WALL_SCALE**2 / (WALL_SCALE**2 + distance**2)
    through = seen > predicted + THROUGH_MARGIN
    mean: Array = (on_wall - THROUGH_WEIGHT * through).mean(axis=1)
    return mean


def log_likelihood(support: Array) -> Array:
    """Ln p(scan | pose) / p(scan | unknown place), (n,), of the mean support (n,)."""
    return NATS * (support - STRANGE_SUPPORT)
