"""Candidates as in the paper: from the eigenspace alone, without the map's walls."""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE
from eigenscan.geometry.circle import TURN
from eigenscan.projector.association.manifold import Matches
from eigenscan.projector.candidates import Candidates, Projected
from eigenscan.projector.connectivity import lattice_poses
from eigenscan.projector.observation import Observation
from eigenscan.projector.site import SensorView, Site
from numpy.typing import NDArray

Array = NDArray[np.float64]


def grid_covariance(spacing: float, heading: float) -> Array:
    """Cp (3, 3): the grid's sample sizes, m and rad, are the standard deviations of a pose (section 7)."""
    return np.diag(np.array([spacing, spacing, heading]) ** 2)


def answer(
    site: Site, view: SensorView, seen: Observation, projected: Projected, found: Matches, most: int
) -> Candidates:
    """The poses of the matches, nearest in eigenspace first, at most `most`.

    ln p(scan | pose) / p(scan | a pose that nobody knows): a pose among k of N near the scan is N / k times
    as likely as any; and -1/2 of ||alpha - alpha'||^2 + ||E||^2 by what nearly no scan of its region exceeds.
    """
    found = found.best(most)
    home, window = view.places(found.rows)
    poses = lattice_poses(site.lattice.positions, home, window, ANALYSIS_TURN, seen.sensor.angle_min)
    poses += found.offsets
    region = np.searchsorted(view.bounds, found.rows, side="right") - 1
    beams = len(seen.coarse) * view.embedding.channels
    usual = np.maximum(view.usual_error[region] * beams, 1e-9)
    chance = np.log(int(view.bounds[-1]) / max(len(found.rows), 1))
    heading = HEADING_STRIDE * TURN / ANALYSIS_TURN
    Cp = grid_covariance(site.lattice.searched_spacing, heading)
    return Candidates(
        poses,
        np.tile(Cp, (len(poses), 1, 1)),
        chance - 0.5 * found.squares / usual,
        np.zeros(len(poses)),
        region,
        projected,
        0.0,
        0.0,
        surfaces=site.readings[0].surfaces,
    )
