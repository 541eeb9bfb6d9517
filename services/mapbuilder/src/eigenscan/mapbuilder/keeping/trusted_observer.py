"""A robot as an observer: which of its scans count, once later ones confirm them."""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Callable
from typing import TypeVar

import numpy as np
from eigenscan.geometry.message_floats import floats_of
from eigenscan.geometry.pose import compose, from_message
from eigenscan.mapbuilder.keeping.claim import Claim, bridge
from eigenscan.mapbuilder.keeping.view import View
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from numpy.typing import ArrayLike

T = TypeVar("T")

FARTHEST = 8.0
"""m, of a beam that counts: beyond, a small error of the heading is a large one of the place."""
LEAST_BEAMS = 20
AGREES, MOSTLY_AGREES = 0.3, 0.7
"""Least share of agreeing beams: of a view, for a room may have changed much, and on average of RECORD."""
RECORD, LEAST_RECORD = 50, 25
"""Most and fewest views on which a robot is judged: a change is a part of 10 m of its way."""
PROBATION = 10
"""Views that must follow before one counts: at least 2 m of way, or turns of 100 degrees."""
WAITING = 64
"""Scans, and poses, that wait for each other."""

Judge = Callable[[View], float]


class TrustedObserver:
    """One lidar of one robot. Scans and poses are matched by stamps, in any order of arrival.

    Sure poses count if odometry connects them. Views between two of them, while the robot was unsure or
    claimed another place, count at the poses that odometry gives.
    """

    def __init__(self, counts: Counter[str]) -> None:
        self._counts = counts
        self._scans: OrderedDict[int, Scan] = OrderedDict()
        self._claims: OrderedDict[int, Claim] = OrderedDict()
        self._anchor: Claim | None = None
        self._seen: Claim | None = None
        self._between: list[tuple[Claim, Scan]] = []
        self._held: deque[View] = deque()
        self._shares: deque[float] = deque(maxlen=RECORD)

    def add_scan(self, scan: Scan, judge: Judge) -> list[View]:
        """Views that now count, because of this scan."""
        stamp = nanoseconds(scan.timestamp)
        claim = self._claims.pop(stamp, None)
        if claim is None:
            _keep(self._scans, stamp, scan)
            return []
        return self._take(claim, scan, judge)

    def add_pose(self, pose: PoseEstimate, judge: Judge) -> list[View]:
        """Views that now count, because of this pose."""
        claim = Claim.of(pose)
        if claim is None:
            self._counts["poses_malformed"] += 1
            return []
        scan = self._scans.pop(claim.stamp, None)
        if scan is None:
            _keep(self._claims, claim.stamp, claim)
            return []
        return self._take(claim, scan, judge)

    def _take(self, claim: Claim, scan: Scan, judge: Judge) -> list[View]:
        if self._anchor is None or self._anchor.is_left_behind(claim):
            self._start_again(claim)
        anchor, new = self._anchor, self._seen is None or self._seen.has_moved(claim)
        if new:
            self._seen = claim
        if anchor is None:
            self._counts["looks_unsure"] += new
            return []
        if claim.is_sure and anchor.leads_to(claim):
            return self._go_on(anchor, claim, scan if new else None, judge)
        if new:
            self._between.append((claim, scan))
        return []

    def _start_again(self, claim: Claim) -> None:
        """Forgets the views that are not confirmed yet."""
        self._counts["looks_withdrawn"] += len(self._held)
        self._counts["looks_unsure"] += len(self._between)
        self._held.clear()
        self._shares.clear()
        self._between.clear()
        self._seen = None
        self._anchor = claim if claim.is_sure else None

    def _go_on(self, anchor: Claim, claim: Claim, scan: Scan | None, judge: Judge) -> list[View]:
        bases = bridge(anchor, claim, [between for between, _ in self._between])
        self._counts["looks_bridged"] += len(bases)
        self._counts["looks_unsure"] += len(self._between) - len(bases)
        for base, (_, between) in zip(bases, self._between, strict=False):
            view = self._view(base, between)
            if view is not None:
                self._held.append(view)
        self._between.clear()
        self._anchor = claim
        view = self._view(claim.base, scan) if scan is not None else None
        if view is not None:
            self._judge(view, judge(view))
        return self._borne_out()

    def _judge(self, view: View, share: float) -> None:
        """Holds a view that agrees; drops all held views if the robot's record is too bad.

        Views between sure poses are not judged, because in a corner with many changes nothing may agree.
        """
        self._shares.append(share)
        if share >= AGREES:
            self._held.append(view)
        else:
            self._counts["looks_disagreeing"] += 1
        if np.mean(self._shares) < MOSTLY_AGREES:
            self._counts["looks_withdrawn"] += len(self._held)
            self._held.clear()

    def _borne_out(self) -> list[View]:
        if len(self._shares) < LEAST_RECORD:
            return []
        count = max(0, len(self._held) - PROBATION)
        self._counts["looks_counted"] += count
        return [self._held.popleft() for _ in range(count)]

    def _view(self, base: ArrayLike, scan: Scan) -> View | None:
        """The beams that show the cell of their end; None if there are too few."""
        ranges = floats_of(scan, "ranges").astype(np.float64)
        bearings = scan.angle_min + np.arange(len(ranges), dtype=np.float64) * scan.angle_increment
        sensor = compose(base, from_message(scan.mount))
        with np.errstate(invalid="ignore"):
            near = (ranges > 0) & (ranges <= FARTHEST)
        if not np.isfinite(sensor).all() or not np.isfinite(bearings).all() or near.sum() < LEAST_BEAMS:
            self._counts["looks_unusable"] += 1
            return None
        return View(nanoseconds(scan.timestamp), sensor, bearings[near], ranges[near])


def _keep(waiting: OrderedDict[int, T], stamp: int, one: T) -> None:
    waiting[stamp] = one
    while len(waiting) > WAITING:
        waiting.popitem(last=False)
