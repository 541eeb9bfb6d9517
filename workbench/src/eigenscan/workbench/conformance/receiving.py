"""Receives a candidate's messages as a subscriber: keys, encodings, quality of service, times."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import zenoh
from eigenscan.schemas.channels import ALIVE_TEMPLATE, CONTRACT_VERSION, HEALTH, Channel, ContractError, find
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode
from google.protobuf.message import Message


@dataclass(frozen=True)
class Received:
    """One sample. `channel` is None for a foreign key, `message` for bytes that do not decode."""

    key: str
    encoding: str
    priority: str
    block: bool
    express: bool
    channel: Channel | None
    address: Mapping[str, str]
    message: Message | None
    fault: str
    at: float
    """s, of the monotonic clock."""

    @property
    def stamp(self) -> int:
        """The message's stamp, ns; 0 if it has none."""
        stamp = getattr(self.message, "timestamp", None)
        return nanoseconds(stamp) if stamp is not None else 0


class Ear:
    """Receives a whole site, without this process's own messages. Safe to use from any thread."""

    def __init__(self, session: zenoh.Session, site: str) -> None:
        self._news = threading.Condition()
        self._own = str(session.zid())
        self._received: list[Received] = []
        self._tokens: dict[str, tuple[float, float | None]] = {}
        self._declared = [
            session.declare_subscriber(f"{site}/**", self._on_sample, allowed_origin=zenoh.Locality.REMOTE),
            session.liveliness().declare_subscriber(f"{site}/*/**", self._on_token, history=True),
        ]

    def received(self) -> list[Received]:
        """All samples so far, in order of arrival."""
        with self._news:
            return list(self._received)

    def tokens(self) -> dict[str, tuple[float, float | None]]:
        """Liveliness tokens by key: when each appeared, and when it went (monotonic s)."""
        with self._news:
            return dict(self._tokens)

    def health(self) -> Health | None:
        """The newest word on itself."""
        for one in reversed(self.received()):
            if one.channel is HEALTH and isinstance(one.message, Health):
                return one.message
        return None

    def wait_for(self, holds: Callable[[], bool], timeout: float) -> bool:
        """Waits until something received makes it so; False after `timeout` seconds."""
        deadline = time.monotonic() + timeout
        while not holds():
            rest = deadline - time.monotonic()
            if rest <= 0.0:
                return False
            with self._news:
                self._news.wait(min(rest, 0.1))
        return True

    def _on_sample(self, sample: Any) -> None:
        at, key, encoding = time.monotonic(), str(sample.key_expr), str(sample.encoding)
        found = find(key)
        message, fault = None, ""
        if found is not None and sample.kind == zenoh.SampleKind.PUT:
            try:
                message = decode(found[0], sample.payload.to_bytes(), encoding)
            except ContractError as error:
                fault = str(error)
        received = Received(
            key,
            encoding,
            str(sample.priority).rpartition(".")[2],
            sample.congestion_control == zenoh.CongestionControl.BLOCK,
            bool(sample.express),
            found[0] if found else None,
            found[1] if found else {},
            message,
            fault,
            at,
        )
        with self._news:
            self._received.append(received)
            self._news.notify_all()

    def _on_token(self, token: Any) -> None:
        key, now = str(token.key_expr), time.monotonic()
        if key.endswith(self._own):  # the token of this session's own models
            return
        with self._news:
            if token.kind == zenoh.SampleKind.PUT:
                self._tokens[key] = (now, None)
            elif key in self._tokens:
                self._tokens[key] = (self._tokens[key][0], now)
            self._news.notify_all()


def alive_key(site: str, service: str, instance: str) -> str:
    """The token that an instance has to hold."""
    address = {"site": site, "service": service, "instance": instance}
    return ALIVE_TEMPLATE.format(**address, contract=CONTRACT_VERSION)
