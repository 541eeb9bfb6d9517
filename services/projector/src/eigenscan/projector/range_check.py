"""Whether a scan fits the map better with other ranges, with its beams at other angles, or mirrored.

A lidar whose unit or offset is wrong sees each wall at another place, and a map of a wrong resolution has it
there. One whose angle increment is wrong sees it at another angle. Neither odometry nor the scans' own motion
shows an offset, nor that the map is mirrored. The map does: at the right pose, the scan that is set right is
by far the likelier one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple
from zlib import crc32

import numpy as np
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.observation import NEAREST, Observation
from eigenscan.projector.projection import fit_around, slide_around
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import RangeCheck, RangeError


class Wrong(NamedTuple):
    """Ranges are `factor` times the true ones, plus `offset`, m; beams are `apart` times as far apart."""

    factor: float = 1.0
    offset: float = 0.0
    apart: float = 1.0


TRIED = (
    *(Wrong(factor=factor) for factor in (0.8, 0.9, 1.1, 1.25)),
    *(Wrong(offset=offset) for offset in (-0.6, -0.3, 0.3, 0.6)),
    *(Wrong(apart=apart) for apart in (0.9, 0.95, 1.05, 1.1)),
)
"""So little off, a fit still finds the pose."""
FITS = 0.9
"""Share of explained beams from which a scan fits as it is: benchmarks/range_errors.py."""
SCALES = tuple(Wrong(factor=factor) for factor in (0.5, 0.64, 0.8, 1.25, 1.56, 2.0))
"""So far off, no list has the pose: a map of 10 cm a cell that states 5, say."""
BY_TURNS = (None, *SCALES[:3], None, *SCALES[3:])
"""By turns, a scan that does not fit is searched for with such an error too, None: mirrored. That costs as
much again."""
AMONG = 5
"""Poses of the list from which each is tried, for the best one may be another."""
BY_CHANCE = 12.0
"""Log-likelihood of the best place in a map of another building: of 20 scans, one comes to more."""


def check(
    site: Site,
    seen: Observation,
    found: Candidates,
    search: Callable[[Observation], Candidates] | None = None,
    also: Wrong | None = None,
) -> RangeCheck | None:
    """Of the errors that are tried, the one with which a scan fits best; `found`: its candidates.

    With a `search` of the whole map `also` one of BY_TURNS, for the scan then fits at another place; a scale
    only where it fits no place as it is. None where it fits nowhere better than by chance, whatever is tried:
    such a scan is no evidence either way.
    """
    if not len(found.poses) or found.explained[0] >= FITS:
        return RangeCheck()
    starts = found.poses[:AMONG]
    right = {error: set_right(seen, error) for error in TRIED}
    # by few beams first: to weigh a scan costs more
    best = min(TRIED, key=lambda error: float(slide_around(site, right[error], starts).cost.min()))
    fitted = fit_around(site, right[best], starts, found.ordinary)
    least = max(float(found.log_likelihoods[0]), BY_CHANCE)
    errors = [RangeError(**best._asdict(), gain=fitted.log_likelihood - least)]
    if search is not None and (also is None or least == BY_CHANCE):
        other = search(mirrored(seen) if also is None else set_right(seen, also)).log_likelihoods
        stated = {"factor": 1.0, "mirrored": True} if also is None else also._asdict()
        if len(other):
            errors.append(RangeError(**stated, searched=True, gain=float(other[0]) - least))
    if least == BY_CHANCE and all(error.gain <= 0.0 for error in errors):
        return None
    return RangeCheck(errors=errors)


def turn_of(stamp: int) -> Wrong | None:
    """With which of BY_TURNS a scan of this stamp, ns, is searched for."""
    return BY_TURNS[crc32(str(stamp).encode()) % len(BY_TURNS)]


def mirrored(seen: Observation) -> Observation:
    """The scan mirrored about its middle beam: on the sensor's own grid, for which the tables are."""
    ranges, coarse = (np.ascontiguousarray(each[::-1]) for each in (seen.ranges, seen.coarse))
    return replace(seen, ranges=ranges, coarse=coarse)


def set_right(seen: Observation, wrong: Wrong) -> Observation:
    """The scan on the analysis grid, as it is if it was measured so wrongly.

    Its middle beam keeps its angle: the pose that fits the wrong scan best is the right one's there.
    """
    ranges = (seen.coarse - np.float32(wrong.offset)) / np.float32(wrong.factor)
    middle = (seen.bearings[0] + seen.bearings[-1]) / 2.0
    bearings = middle + (seen.bearings - middle) / wrong.apart
    return replace(seen, coarse=np.maximum(ranges, np.float32(NEAREST)), bearings=bearings)
