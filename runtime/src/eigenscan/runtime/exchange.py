"""Messages between the services of one process: handed over as they are, without a way through Zenoh.

They are published all the same, for everybody else. Nobody may change a message once it is published.
"""

from __future__ import annotations

import threading
from typing import Any

import zenoh
from eigenscan.runtime.intake import Intake
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.recently_used import RecentlyUsed
from google.protobuf.message import Message


class Exchange:
    """Who hears what within the process; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._hearers: list[tuple[zenoh.KeyExpr, Intake]] = []
        self._routes: RecentlyUsed[str, tuple[Intake, ...]] = RecentlyUsed()

    def listen(self, selector: str, intake: Intake) -> None:
        """From now on hands to `intake` what is published on keys that `selector` matches."""
        with self._lock:
            self._hearers.append((zenoh.KeyExpr(selector), intake))
            self._routes = RecentlyUsed()

    def hand(self, channel: Channel, key: str, message: Message, payload: bytes, stamp: Any) -> None:
        """Gives a message to all who hear it, in this thread; `payload` is the same, encoded."""
        with self._lock:
            route = self._routes.use(key, lambda: self._route(key))
        for intake in route:
            intake.on_message(channel, key, message, payload, stamp)

    def _route(self, key: str) -> tuple[Intake, ...]:
        return tuple(intake for selector, intake in self._hearers if selector.intersects(key))
