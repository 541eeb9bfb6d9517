"""Moments as people write them: of a recording, or of the past."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import typer
from eigenscan.runtime.errors import UsageError
from eigenscan.workbench.playback.controls import MOST_S

_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:\.\d+)?))?")
METAVAR = "<s or hh:mm[:ss]>"


@dataclass(frozen=True)
class Moment:
    """Seconds from a recording's start; or, `of_day`, from midnight UTC."""

    seconds: float
    of_day: bool = False

    def __str__(self) -> str:
        """As `--help` shows a default."""
        return f"{self.seconds:g}"

    def after(self, begin: int) -> float:
        """Seconds after `begin` (log time, ns); a time of day before `begin` means the next day."""
        if not self.of_day:
            return self.seconds
        start = datetime.fromtimestamp(begin * 1e-9, UTC)
        midnight = start.replace(hour=0, minute=0, second=0, microsecond=0)
        wait = midnight + timedelta(seconds=self.seconds) - start
        return (wait % timedelta(days=1)).total_seconds()


START = Moment(0.0)
"""Start of any recording."""


def moment(text: str | Moment) -> Moment:
    """Reads the value of an option: seconds, or a time of day. Raises typer's error for other texts."""
    if isinstance(text, Moment):
        return text
    clock = _CLOCK.fullmatch(text)
    if clock:
        hours, minutes, seconds = int(clock[1]), int(clock[2]), float(clock[3] or 0.0)
        if hours < 24 and minutes < 60 and seconds < 60:
            return Moment(3600.0 * hours + 60.0 * minutes + seconds, of_day=True)
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not 0.0 <= seconds <= MOST_S:
        raise typer.BadParameter(f"{text!r}: give s from the recording's start, or UTC as 03:12 or 03:12:30")
    return Moment(seconds)


def span(begin: int, end: int) -> str:
    """Begin and end of a recording (ns since the epoch) as text."""
    first, last = (datetime.fromtimestamp(time * 1e-9, UTC) for time in (begin, end))
    return f"{first:%Y-%m-%d %H:%M:%S} to {last:%H:%M:%S} UTC, {(end - begin) * 1e-9:.1f} s"


_AGO = re.compile(r"(\d+(?:\.\d+)?)(s|m|h|d)")
_UNITS_S = {"s": 1.0, "m": 60.0, "h": 3600.0, "d": 86400.0}
INSTANT = "<ago, hh:mm or date>"


def instant(option: str, text: str, now: int) -> int:
    """The value of `option` as a moment in the past, ns since the epoch; `now` is the present, likewise.

    `15m`: 15 minutes ago (s, m, h, d). `03:12` or `03:12:30`: the last such time of day, UTC.
    `2026-01-31T03:12`: ISO 8601, UTC unless it names a zone. `now`: `now`. Raises UsageError for other texts.
    """
    if text == "now":
        return now
    try:
        if ago := _AGO.fullmatch(text):
            return max(0, now - int(float(ago[1]) * _UNITS_S[ago[2]] * 1e9))
        if _CLOCK.fullmatch(text):
            today = datetime.fromtimestamp(now * 1e-9, UTC)
            midnight = today.replace(hour=0, minute=0, second=0, microsecond=0)
            then = midnight + timedelta(seconds=moment(text).seconds)
            return _ns(then if then <= today else then - timedelta(days=1))
        then = datetime.fromisoformat(text)
        return _ns(then if then.tzinfo else then.replace(tzinfo=UTC))
    except (ValueError, OverflowError, typer.BadParameter):
        raise UsageError(
            f"{option} {text}: give how long ago (15m, 2h), a time of day in UTC (03:12), or 2026-01-31T03:12"
        ) from None


def _ns(time: datetime) -> int:
    return round((time - datetime.fromtimestamp(0, UTC)) / timedelta(microseconds=1)) * 1000
