"""What happened to the services: each change of status as a line of text."""

from __future__ import annotations

import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health

LEVELS = {
    Health.STATUS_OK: rr.TextLogLevel.INFO,
    Health.STATUS_WAITING: rr.TextLogLevel.WARN,
    Health.STATUS_DEGRADED: rr.TextLogLevel.ERROR,
}


class Events:
    """Draws changes of health at the time of the newest data: the log may be of another day."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._last: dict[tuple[str, str], tuple[int, str]] = {}

    def hear_health(self, heard: Envelope) -> None:
        """One line where status or detail changed."""
        message = heard.open(Health)
        who = heard.address["service"], heard.address["instance"]
        told = message.status, _steady(message.detail)
        if not self._canvas.newest or self._last.get(who) == told:
            return
        self._last[who] = told
        known = message.status in LEVELS
        word = Health.Status.Name(message.status).removeprefix("STATUS_") if known else "?"
        text = f"{'/'.join(who)}: {word} {message.detail}".rstrip()
        level = LEVELS.get(message.status, rr.TextLogLevel.WARN)
        self._canvas.draw(self._canvas.newest, f"events/{who[0]}", rr.TextLog(text, level=level))


def _steady(detail: str) -> str:
    """The detail without its figures, which change all the time."""
    return "".join(letter for letter in detail if not letter.isdigit())
