"""Hands messages between the services of one process, without Zenoh.

They are also published, for other processes. A published message must not be changed.
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
    """Subscriptions within the process; safe to use from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._subscribers: list[tuple[zenoh.KeyExpr, Intake]] = []
        self._routes: RecentlyUsed[str, tuple[Intake, ...]] = RecentlyUsed()

    def listen(self, selector: str, intake: Intake) -> None:
        """Hands messages on keys that `selector` matches to `intake`, from now on."""
        with self._lock:
            self._subscribers.append((zenoh.KeyExpr(selector), intake))
            self._routes = RecentlyUsed()

    def hand(self, channel: Channel, key: str, message: Message, payload: bytes, stamp: Any) -> None:
        """Gives a message to all its subscribers, in this thread; `payload`: the encoded message."""
        with self._lock:
            route = self._routes.use(key, lambda: self._route(key))
        for intake in route:
            intake.on_message(channel, key, message, payload, stamp)

    def _route(self, key: str) -> tuple[Intake, ...]:
        return tuple(intake for selector, intake in self._subscribers if selector.intersects(key))
