"""How often a thing is drawn anew."""

from __future__ import annotations


class Pace:
    """Lets the first message of each period pass, for each key of its own.

    Periods are cut from the stamps, so that all messages that follow from one scan pass together.
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
