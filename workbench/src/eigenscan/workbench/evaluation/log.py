"""A log as the pipeline receives it: raw scans and odometry, in the order in which they were recorded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import ODOMETRY, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.reference import NS
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions, open_log
from numpy.typing import NDArray

WARM_UP = 200


@dataclass(frozen=True)
class Received:
    """One message and its own stamp, ns."""

    stamp: int
    envelope: Envelope


class Log:
    """All scans and odometry of a log; every lidar counts."""

    def __init__(
        self,
        received: list[Received],
        logged: Mapping[int, int] | None = None,
        *,
        damage: str = "",
        set_aside: Mapping[str, int] | None = None,
    ) -> None:
        self._received = received
        self.set_aside = set_aside or {}
        """What its reader counted."""
        self.damage = damage
        """What was not read of a recording, and what saves it."""
        self.logged = logged or {}
        """Stamp as logged, ns, of each scan that was given another one, by that one."""
        self._stamps = np.asarray([h.stamp for h in received], dtype=np.int64)
        self._is_scan = np.asarray([h.envelope.channel == SCAN_RAW for h in received], dtype=np.bool_)

    @property
    def scans(self) -> NDArray[np.int64]:
        """Stamps (n,) of all scans, ns, in the log's order."""
        return self._stamps[self._is_scan]

    @property
    def lidars(self) -> list[str]:
        """Names of the lidars."""
        return sorted({h.envelope.address["lidar"] for h in self._received if h.envelope.channel == SCAN_RAW})

    @property
    def is_cut(self) -> bool:
        """Whether the file breaks off, or is damaged from some place on."""
        return any(name in self.set_aside for name in ("truncated_file", "damaged_file"))

    @property
    def odometry(self) -> int:
        """Odometry messages in all."""
        return int(np.count_nonzero(~self._is_scan))

    @property
    def whole(self) -> list[Envelope]:
        """All of it, in the log's order."""
        return [received.envelope for received in self._received]

    @property
    def beginning(self) -> list[Envelope]:
        """The first messages: enough to warm up on."""
        return [received.envelope for received in self._received[:WARM_UP]]

    def between(self, window: Window) -> list[Envelope]:
        """Messages stamped within a window, in the log's order."""
        inside = (self._stamps >= window.start) & (self._stamps <= window.end)
        return [self._received[index].envelope for index in np.flatnonzero(inside)]

    def outside(self, windows: Sequence[Window]) -> Log:
        """The log without these windows."""
        kept = [one for one in self._received if not any(window.holds(one.stamp) for window in windows)]
        return Log(kept, self.logged, damage=self.damage, set_aside=self.set_aside)

    def scan_stamps(self, window: Window) -> NDArray[np.int64]:
        """Stamps of the scans within a window, ns, increasing."""
        stamps = np.sort(self.scans)
        return stamps[np.searchsorted(stamps, window.start) : np.searchsorted(stamps, window.end, "right")]

    def nearest_scan(self, stamp: int, within_s: float) -> Received | None:
        """The scan with the nearest stamp; None if there is none within `within_s` seconds."""
        distance = np.where(self._is_scan, np.abs(self._stamps - stamp), np.iinfo(np.int64).max)
        index = int(np.argmin(distance)) if len(distance) else 0
        return self._received[index] if len(distance) and distance[index] <= within_s * NS else None

    @staticmethod
    def canonical(raw: Envelope) -> Scan | None:
        """scan-ingest's scan of one raw scan; None if it is rejected."""
        core = ScanIngestCore(ScanIngestSettings())
        published = [*core.handle(raw), *core.finish()]
        return next((envelope.open(Scan) for envelope in published if envelope.channel == SCAN), None)


def read_log(path: Path, options: LogOptions, moved: Callable[[float], None]) -> Log:
    """Reads any log that `eigenscan import` reads. Raises LogError.

    `moved` is called with the progress, 0..1.
    """
    opened = open_log(path, options)
    received = []
    for envelope in opened.envelopes():
        if envelope.channel in (SCAN_RAW, ODOMETRY):
            received.append(Received(envelope.stamp, envelope))
            moved(opened.progress)
    moved(1.0)
    return Log(received, opened.logged, damage=opened.damage, set_aside=+opened.counters)
