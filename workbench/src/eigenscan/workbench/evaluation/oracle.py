"""Finds the kidnaps that the scans soon after them decide: nobody can tell two rooms apart that look alike.

The oracle knows what the pipeline does not: how the robot moved, by the reference, and all scans at once. Its
candidates are the true place and each place that the pipeline lists for one of these scans.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np
from eigenscan.geometry.pose import between, compose, inverse
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.evaluation.doubt import Walls
from eigenscan.workbench.evaluation.metrics import elsewhere, errors, right
from eigenscan.workbench.evaluation.pipeline import Answer
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from eigenscan.workbench.evaluation.windows import thin
from numpy.typing import NDArray

SOON_S = 3.0
"""The scans of so long after the jump count."""
MOST_SCANS = 15
"""Scans that are looked at, evenly chosen."""
Answers = Callable[[Iterable[Envelope]], Iterable[Answer]]
"""Answers each raw scan alone."""


def soon_after(received: Iterable[Envelope], start: int) -> list[Envelope]:
    """The raw scans of the 3 s from `start`, ns; of more than 15 as many, evenly chosen."""
    scans = [e for e in received if e.channel == SCAN_RAW and 0 <= e.stamp - start <= SOON_S * NS]
    return thin(scans, MOST_SCANS)


def decides(scans: Sequence[Envelope], answers: Answers, reference: Trajectory, walls: Walls) -> bool | None:
    """Whether more returns of the raw scans lie on walls from the true place than from any other.

    None if no scan has a reference and enough returns.
    """
    truths, known = reference.at([scan.stamp for scan in scans])
    seen = [(scan, truth) for scan, truth, there in zip(scans, truths, known, strict=True) if there]
    if not seen:
        return None
    start = seen[0][1]
    ways = [between(start, truth) for _, truth in seen]
    listed = [
        compose(a.poses, inverse(way)) for a, way in zip(answers(s for s, _ in seen), ways, strict=True)
    ]
    places = np.concatenate([start[None], *listed])
    shares = [_shares(scan, compose(places, way), walls) for (scan, _), way in zip(seen, ways, strict=True)]
    if not np.isfinite(shares).any():
        return None
    fits = np.nanmean(shares, axis=0)
    off, turned = errors(places, np.broadcast_to(start, places.shape))
    others = fits[elsewhere(off, turned)]
    return bool(fits[right(off, turned)].max() > others.max(initial=0.0))


def _shares(raw: Envelope, bases: NDArray[np.float64], walls: Walls) -> NDArray[np.float64]:
    scan = walls.canonical(raw)
    if scan is None:
        return np.full(len(bases), np.nan)
    return walls.shares(scan, bases)
