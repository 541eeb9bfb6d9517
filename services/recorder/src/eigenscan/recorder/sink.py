"""Where the recorder puts what it hears."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from eigenscan.schemas.envelope import Envelope


class Sink(Protocol):
    """Takes every message. Trouble of its own is a `problem`, not an exception."""

    @property
    def problem(self) -> str:
        """Why it cannot do its work now; empty while it can."""
        ...

    @property
    def counters(self) -> Mapping[str, int]:
        """What was taken and what was lost."""
        ...

    def write(self, heard: Envelope) -> None:
        """Takes one message."""
        ...

    def close(self) -> None:
        """Completes what was written. Nothing may be written after it."""
        ...
