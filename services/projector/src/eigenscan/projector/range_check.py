"""Whether a scan fits the map better with other ranges: of a wrong scale, or with an offset.

A lidar whose unit or offset is wrong sees each wall at another place, and a map of a wrong resolution has it
there. Neither odometry nor the scans' own motion shows an offset. The map does: at the right pose, the scan
with its ranges set right is by far the likelier one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.observation import NEAREST, Observation
from eigenscan.projector.projection import fit_around, slide_around
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import RangeCheck, RangeError

TRIED = (
    *((factor, 0.0) for factor in (0.8, 0.9, 1.1, 1.25)),
    *((1.0, offset) for offset in (-0.6, -0.3, 0.3, 0.6)),
)
"""Factors and offsets, m, of a measured range: so little off, a fit still finds the pose."""
FITS = 0.9
"""Share of explained beams from which a scan fits as it is: benchmarks/range_errors.py."""
AMONG = 5
"""Poses of the list from which each is tried, for the best one may be another."""
BY_CHANCE = 12.0
"""Log-likelihood of the best place in a map of another building: of 20 scans, one comes to more."""


def check(site: Site, seen: Observation, found: Candidates) -> RangeCheck:
    """Of the errors that are tried, the one with which a scan fits best; `found`: its candidates."""
    if not len(found.poses) or found.explained[0] >= FITS:
        return RangeCheck()
    starts = found.poses[:AMONG]
    right = {error: set_right(seen, *error) for error in TRIED}
    # by few beams first: to weigh a scan costs more
    best = min(TRIED, key=lambda error: float(slide_around(site, right[error], starts).cost.min()))
    fitted = fit_around(site, right[best], starts, found.ordinary)
    gain = fitted.log_likelihood - max(float(found.log_likelihoods[0]), BY_CHANCE)
    return RangeCheck(errors=[RangeError(factor=best[0], offset=best[1], gain=gain)])


def set_right(seen: Observation, factor: float, offset: float) -> Observation:
    """The scan with the ranges of the analysis grid as they are if they were measured so wrongly."""
    right = np.maximum((seen.coarse - np.float32(offset)) / np.float32(factor), np.float32(NEAREST))
    return replace(seen, coarse=right)
