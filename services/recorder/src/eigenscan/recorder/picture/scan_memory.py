"""The last scans of every lidar: what follows from a scan comes later, on another key."""

from __future__ import annotations

from collections import deque

from eigenscan.recorder.picture.canvas import stamp_of
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import Scan

SCANS_KEPT = 32


class ScanMemory:
    """Keeps SCANS_KEPT scans of each lidar of each robot."""

    def __init__(self) -> None:
        self._scans: RecentlyUsed[tuple[str, str], deque[tuple[int, Scan]]] = RecentlyUsed()

    def keep(self, heard: Envelope) -> None:
        """Remembers the scan, where its stamp is a time."""
        scan = heard.open(Scan)
        stamp = stamp_of(scan.timestamp)
        if stamp is not None:
            lidar = heard.address["robot"], heard.address["lidar"]
            self._scans.use(lidar, lambda: deque(maxlen=SCANS_KEPT)).append((stamp, scan))

    def lidars(self, robot: str) -> list[str]:
        """Lidars of `robot` that have been heard."""
        return [lidar for (owner, lidar), _ in self._scans.items() if owner == robot]

    def newest(self, robot: str, lidar: str, until: int, age: int = 0) -> Scan | None:
        """The last scan that came and is stamped `until` (ns) or at most `age` ns before."""
        scans = self._scans.get((robot, lidar)) or ()
        fitting = [scan for stamp, scan in scans if until - age <= stamp <= until]
        return fitting[-1] if fitting else None
