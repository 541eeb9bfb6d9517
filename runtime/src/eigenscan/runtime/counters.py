"""Counters of a service, and warnings about what it rejects."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import Any

from eigenscan.runtime.clock import Clock
from eigenscan.runtime.logs import Logger

WARNING_PERIOD_S = 1.0
"""Shortest time between two warnings of one reason, s: a faulty sensor must not fill the log."""


class Counters:
    """Counters by name, with warnings in the log."""

    def __init__(self, log: Logger, clock: Clock = time) -> None:
        self.counts: Counter[str] = Counter()
        self._log, self._clock = log, clock
        self._warned_at: dict[str, float] = {}

    def set_aside(
        self, reason: str, key: str, error: BaseException | None = None, *, trace: bool = False
    ) -> None:
        """Counts a rejected message and warns; `trace`: with the error's trace."""
        self.counts[reason] += 1
        self.warn(
            reason,
            key=key,
            error=str(error) if error else "",
            count=self.counts[reason],
            exc_info=error if trace else None,
        )

    def warn(self, reason: str, **context: Any) -> None:
        """Logs a warning, at most once in WARNING_PERIOD_S for each reason."""
        now = self._clock.monotonic()
        if now - self._warned_at.get(reason, -math.inf) >= WARNING_PERIOD_S:
            self._warned_at[reason] = now
            self._log.warning(reason, **context)
