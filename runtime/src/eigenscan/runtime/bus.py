"""Zenoh as the contract uses it: envelopes out, samples into an inbox, latched channels by query."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import zenoh
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import (
    ALIVE_TEMPLATE,
    CONTRACT_VERSION,
    Channel,
    ContractError,
    Priority,
    find,
)
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import encode, encoding

_PRIORITY = {
    Priority.REAL_TIME: zenoh.Priority.REAL_TIME,
    Priority.INTERACTIVE_HIGH: zenoh.Priority.INTERACTIVE_HIGH,
    Priority.DATA: zenoh.Priority.DATA,
    Priority.DATA_LOW: zenoh.Priority.DATA_LOW,
    Priority.BACKGROUND: zenoh.Priority.BACKGROUND,
}


def open_session(path: Path | None) -> zenoh.Session:
    """Session from a JSON5 file, or an embedded peer that finds its neighbours by multicast.

    Raises ContractError naming the file where it is no Zenoh configuration or no session opens.
    """
    try:
        config = zenoh.Config.from_file(str(path)) if path else zenoh.Config()
    except zenoh.ZError as error:
        raise ContractError(f"{path}: is no Zenoh configuration: {error}") from error
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise ContractError(f"{path or 'embedded peer'}: no Zenoh session: {error}") from error


class Bus:
    """One service's connection. Closing it undeclares all and joins Zenoh's threads."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._publishers: dict[str, Any] = {}
        self._latched: dict[str, tuple[Channel, bytes]] = {}
        self._lock = threading.Lock()
        self._declared: list[Any] = []

    def __enter__(self) -> Bus:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def announce(self, site: str, service: str, instance: str) -> None:
        """Holds a liveliness token for as long as this bus lives."""
        key = ALIVE_TEMPLATE.format(site=site, service=service, instance=instance, contract=CONTRACT_VERSION)
        self._declared.append(self._session.liveliness().declare_token(key))

    def offer(self, channels: Sequence[Channel], address: Mapping[str, str]) -> None:
        """Answers queries for the newest samples of the latched ones among `channels`."""
        for channel in channels:
            if channel.qos.latched:
                self._declared.append(
                    self._session.declare_queryable(channel.selector(address), self._answer)
                )

    def _answer(self, query: Any) -> None:
        with self._lock:
            found = [(key, held) for key, held in self._latched.items() if query.key_expr.intersects(key)]
        for key, (channel, payload) in found:
            query.reply(key, payload, encoding=zenoh.Encoding(encoding(channel)))

    def listen(self, channels: Sequence[Channel], address: Mapping[str, str], inbox: Inbox) -> None:
        """Fills `inbox` from all keys of `channels` that fit `address`; latched ones also from the past."""
        for channel in channels:
            self._listen(channel, channel.selector(address), inbox)

    def listen_all(self, channels: Sequence[Channel], selector: str, inbox: Inbox) -> None:
        """Fills `inbox` from every key that `selector` matches; each sample goes to its own channel."""

        def on_sample(sample: Any) -> None:
            key = str(sample.key_expr)
            found = find(key)
            if found and found[0] in channels:
                inbox.put(found[0], key, sample.payload.to_bytes(), str(sample.encoding))
            else:
                inbox.dropped["foreign_key"] += 1

        self._declared.append(self._session.declare_subscriber(selector, on_sample))

    def _listen(self, channel: Channel, selector: str, inbox: Inbox) -> None:
        def on_sample(sample: Any) -> None:
            inbox.put(channel, str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))

        def on_reply(reply: Any) -> None:
            if reply.ok is not None:
                on_sample(reply.ok)

        self._declared.append(self._session.declare_subscriber(selector, on_sample))
        if channel.qos.latched:
            self._session.get(selector, on_reply, target=zenoh.QueryTarget.ALL)

    def say(self, envelope: Envelope) -> None:
        """Publishes one message with its channel's quality of service."""
        channel, key = envelope.channel, envelope.key
        payload = encode(envelope.message)
        if channel.qos.latched:
            with self._lock:
                self._latched[key] = (channel, payload)
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._session.declare_publisher(
                key,
                encoding=zenoh.Encoding(encoding(channel)),
                priority=_PRIORITY[channel.qos.priority],
                express=channel.qos.express,
                congestion_control=zenoh.CongestionControl.BLOCK
                if channel.qos.block
                else zenoh.CongestionControl.DROP,
            )
            self._publishers[key] = publisher
        publisher.put(payload)

    def close(self) -> None:
        """Undeclares everything, then closes the session."""
        for declared in [*self._publishers.values(), *self._declared]:
            declared.undeclare()
        self._publishers.clear()
        self._declared.clear()
        self._session.close()  # type: ignore[no-untyped-call]
