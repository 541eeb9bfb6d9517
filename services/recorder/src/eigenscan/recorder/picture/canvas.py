"""The surface that is drawn on: a Rerun recording stream with one timeline, the messages' own stamps."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import Array
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import Scan
from google.protobuf.timestamp_pb2 import Timestamp
from numpy.typing import ArrayLike

TIMELINE = "time"
REPEAT_NS = 30_000_000_000
"""Interval after which rare content is drawn again, ns, because a late viewer lacks old data."""
FAR_M = 10_000.0
"""A map farther from its frame's origin, m, is drawn from a corner of its own: a viewer's single precision
has steps of 1 mm there, and of 0.5 m in a map with UTM coordinates."""
LATEST_NS = 2**62
"""Stamps beyond it (year 2116) are no times."""


class Canvas:
    """Logs to Rerun at the stamp of the drawn message."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self.stream = stream
        self._styled: set[str] = set()
        self._shown: set[str] = set()
        self.newest = 0
        """Stamp of the last thing drawn, ns since the epoch."""
        self.corner = np.zeros(2)
        """The place, map frame, m, that is drawn at the viewer's origin."""

    def start_from(self, low: Array) -> None:
        """Draws from here on relative to the whole kilometre below `low` (2,), m, if that is far away."""
        if np.abs(low).max() > FAR_M:
            self.corner = np.floor(low / 1000.0) * 1000.0

    def local(self, rows: ArrayLike) -> Array:
        """Poses or points (..., 2 or 3) of the map frame as the viewer places them."""
        moved = np.array(rows, dtype=np.float64)
        moved[..., :2] -= self.corner
        return moved

    def draw(self, stamp: int, path: str, *things: Any) -> None:
        """Puts `things` at `path` from `stamp` on."""
        self.newest = stamp
        self._shown.add(path)
        self.stream.set_time(TIMELINE, timestamp=np.datetime64(stamp, "ns"))
        self.stream.log(path, things[0], *things[1:])

    def clear(self, stamp: int, path: str) -> None:
        """Removes the content of `path` from `stamp` on, if there is any."""
        if path in self._shown:
            self.draw(stamp, path, rr.Clear(recursive=False))
            self._shown.remove(path)

    def fix(self, path: str, *things: Any) -> None:
        """Puts `things` at `path` for all times."""
        self.stream.log(path, things[0], *things[1:], static=True)

    def style(self, path: str, make: Callable[[], tuple[Any, ...]]) -> None:
        """Sets the style (colours, sizes) of `path` for all times, once."""
        if path not in self._styled:
            self._styled.add(path)
            self.fix(path, *make())

    def plot(self, path: str, stamps: Sequence[int], rows: Sequence[Iterable[float]]) -> None:
        """Adds rows of scalars, one a stamp, in one go."""
        times = np.array(stamps, dtype="datetime64[ns]")
        values = np.array([list(row) for row in rows], dtype=np.float64)
        columns = rr.Scalars.columns(scalars=values.ravel()).partition([values.shape[1]] * len(values))
        self.stream.send_columns(path, [rr.TimeColumn(TIMELINE, timestamp=times)], columns)


def stamp_of(timestamp: Timestamp) -> int | None:
    """Ns since the epoch; None for a time that cannot be shown."""
    stamp = nanoseconds(timestamp)
    return stamp if 0 < stamp < LATEST_NS else None


class Pace:
    """Passes the first message of each period, for each key.

    Periods follow the stamps, so all messages of one scan pass together.
    """

    def __init__(self, rate_hz: float) -> None:
        self._period = max(int(1e9 / rate_hz), 1)
        self._last: dict[str, int] = {}

    def due(self, key: str, stamp: int) -> bool:
        """Whether the message of `key` at `stamp` (ns) is to be drawn."""
        period = stamp // self._period
        if self._last.get(key) == period:
            return False
        self._last[key] = period
        return True


SCANS_KEPT = 32


class ScanMemory:
    """Keeps SCANS_KEPT scans of each lidar of each robot."""

    def __init__(self) -> None:
        self._scans: RecentlyUsed[tuple[str, str], deque[tuple[int, Scan]]] = RecentlyUsed()

    def keep(self, received: Envelope) -> None:
        """Stores the scan, if its stamp is valid."""
        scan = received.open(Scan)
        stamp = stamp_of(scan.timestamp)
        if stamp is not None:
            lidar = received.address["robot"], received.address["lidar"]
            self._scans.use(lidar, lambda: deque(maxlen=SCANS_KEPT)).append((stamp, scan))

    def lidars(self, robot: str) -> list[str]:
        """Lidars of `robot` that have been received."""
        return [lidar for (owner, lidar), _ in self._scans.items() if owner == robot]

    def newest(self, robot: str, lidar: str, until: int, age: int = 0) -> Scan | None:
        """The last scan that came and is stamped `until` (ns) or at most `age` ns before."""
        scans = self._scans.get((robot, lidar)) or ()
        fitting = [scan for stamp, scan in scans if until - age <= stamp <= until]
        return fitting[-1] if fitting else None
