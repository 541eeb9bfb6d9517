"""The surface that is drawn on: a Rerun recording stream with one timeline, the messages' own stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import rerun as rr
from eigenscan.schemas.envelope import nanoseconds
from google.protobuf.timestamp_pb2 import Timestamp

TIMELINE = "time"
REPEAT_NS = 30_000_000_000
"""What changes seldom is drawn again after this: a late viewer is not given what is long ago."""
LATEST_NS = 2**62
"""Stamps beyond it (year 2116) are no times."""


class Canvas:
    """Logs at the stamp of what is drawn."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)
        self.stream = stream
        self._styled: set[str] = set()
        self._shown: set[str] = set()
        self.newest = 0
        """Stamp of the last thing drawn, ns since the epoch."""

    def draw(self, stamp: int, path: str, *things: Any) -> None:
        """Puts `things` at `path` from `stamp` on."""
        self.newest = stamp
        self._shown.add(path)
        self.stream.set_time(TIMELINE, timestamp=np.datetime64(stamp, "ns"))
        self.stream.log(path, things[0], *things[1:])

    def clear(self, stamp: int, path: str) -> None:
        """Takes away what is at `path` from `stamp` on, where there is something."""
        if path in self._shown:
            self.draw(stamp, path, rr.Clear(recursive=False))
            self._shown.remove(path)

    def fix(self, path: str, *things: Any) -> None:
        """Puts `things` at `path` for all times."""
        self.stream.log(path, things[0], *things[1:], static=True)

    def style(self, path: str, make: Callable[[], tuple[Any, ...]]) -> None:
        """Puts what `make` gives (colours, sizes) at `path` for all times, unless that was done before."""
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
    """Ns since the epoch, or None where that is no time that can be shown."""
    stamp = nanoseconds(timestamp)
    return stamp if 0 < stamp < LATEST_NS else None
