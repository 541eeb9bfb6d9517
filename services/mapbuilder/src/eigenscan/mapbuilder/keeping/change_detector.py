"""Collects the evidence of a site's robots, and detects changes from it."""

from __future__ import annotations

from collections import Counter

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.keeping.agreement import Agreement
from eigenscan.mapbuilder.keeping.change import Change, find_change
from eigenscan.mapbuilder.keeping.evidence import Evidence
from eigenscan.mapbuilder.keeping.trusted_observer import TrustedObserver
from eigenscan.mapbuilder.keeping.view import View, mark
from eigenscan.schemas.channels import POSE, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate

IN_A_ROW = 20
"""Views a day or more off that are set aside, until as many follow each other: then time has gone on."""


class ChangeDetector:
    """Receives scans and poses of all robots of a site; returns the changes at the end of a visit."""

    def __init__(self, grid: GridMap, evidence: Evidence, visits: int, frame_id: str = "map") -> None:
        self.evidence = evidence
        self.counts: Counter[str] = Counter()
        self._visits, self._frame_id = visits, frame_id
        self._set_aside, self._whose = 0, ""
        """Views in a row that were days off, and the last one's robot."""
        self._odd = ""
        """A robot whose clock is days off the others'."""
        self._observers: RecentlyUsed[str, RecentlyUsed[str, TrustedObserver]] = RecentlyUsed()
        """By robot, then by lidar."""
        self.trust(grid)

    def trust(self, grid: GridMap) -> None:
        """Uses this map from now on. It must have the same cells as the one before."""
        self._grid, self._agreement = grid, Agreement(grid)

    def fits(self, grid: GridMap) -> bool:
        """Whether a map has the same cells, with any content."""
        own = self._grid
        same = grid.cells.shape == own.cells.shape and grid.resolution == own.resolution
        return same and bool(np.array_equal(grid.origin, own.origin))

    def receive(self, received: Envelope) -> Change | None:
        """The change that is known now, at the end of each visit; else None."""
        robot, judge = received.address["robot"], self._agreement.share
        views: list[View] = []
        if received.channel is SCAN:
            scan = received.open(Scan)
            lidars = self._observers.use(robot, RecentlyUsed)
            observer = lidars.use(received.address["lidar"], lambda: TrustedObserver(self.counts))
            views = observer.add_scan(scan, judge)
        elif received.channel is POSE:
            pose = received.open(PoseEstimate)
            if pose.frame_id != self._frame_id:
                self.counts["poses_of_another_frame"] += 1
                return None
            for _, observer in self._observers.use(robot, RecentlyUsed).items():
                views += observer.add_pose(pose, judge)
        ended = [self._count(view, robot) for view in views]
        return find_change(self._grid, self.evidence.run, self._visits) if any(ended) else None

    @property
    def problem(self) -> str:
        """Which robot's views are set aside, and why; empty: none's."""
        apart = f"the clock of {self._odd} and those of other robots are over a day apart: set them"
        return apart if self._odd else ""

    def _count(self, view: View, robot: str) -> bool:
        days_off = self.evidence.is_days_off(view.stamp)
        if days_off and self._set_aside < IN_A_ROW:
            self._set_aside, self._whose = self._set_aside + 1, robot
            self.counts["looks_of_another_day"] += 1
            return False
        if self._set_aside and not days_off:  # others' time goes on meanwhile
            self._odd = self._whose
        self._set_aside = 0
        if robot == self._odd:
            self._odd = ""
        ended = self.evidence.turn_to(view.stamp)
        self.evidence.add(mark(view, self._grid, self._agreement.contradicts(view)))
        return ended
