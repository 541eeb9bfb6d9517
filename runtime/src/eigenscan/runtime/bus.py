"""Zenoh as the contract uses it: envelopes out, samples into an inbox, latched channels by query.

The publisher of a latched channel holds its newest samples and answers queries on their keys. A publisher
that holds some shows a liveliness token. A subscriber queries at each new token, so neither the order of
starts nor an interrupted link matters.
"""

from __future__ import annotations

import contextlib
import threading
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import zenoh
from eigenscan.runtime.callback import at_once
from eigenscan.runtime.clock import Later, later
from eigenscan.runtime.exchange import Exchange
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.intake import Intake, digests_in
from eigenscan.runtime.interruptions import Interruptions
from eigenscan.runtime.latched_cache import digest
from eigenscan.runtime.receive_watchdog import ReceiveWatchdog
from eigenscan.schemas.channels import (
    ALIVE_TEMPLATE,
    CONTRACT_VERSION,
    HEALTH,
    LATCHED_TEMPLATE,
    Channel,
    Priority,
)
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.group import selectors
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.wire import encode, encoding

LATCHED_TIMEOUT_S = 7200.0
"""Longest wait for the whole of a publisher's answer, s: 600 MB of models at 85 kB/s.

Nothing asks again for what did not come in time. Where publisher or link are gone, Zenoh ends the query.
"""

STAGGER_S = 5.0
"""Period over which subscribers that hold samples spread their queries, s.

After a cut a whole fleet sees the publisher return at once."""

MOST_PATIENT = 16_384
"""Samples that wait in Zenoh at most; then the oldest goes. 100 robots' odometry of three seconds."""

LISTENER_POLL_S = 0.02

_PRIORITY = {priority: getattr(zenoh.Priority, priority.name) for priority in Priority}


class Bus:
    """One service's connection; safe to use from several threads. Closing it undeclares all."""

    def __init__(
        self,
        session: zenoh.Session,
        exchange: Exchange | None = None,
        after: Later = later,
        *,
        publishes_inside: bool = False,
    ) -> None:
        """`exchange`: the other services of this process.

        They share the session, so closing leaves it open. `publishes_inside`: an inbox's `on_put` publishes,
        so each subscription has a thread: Zenoh's own, which reads the socket, must not wait for room there.
        """
        self._session, self._exchange, self._after = session, exchange, after
        self._publishes_inside = publishes_inside
        self._idle: list[Any] = []
        self._publishers: RecentlyUsed[str, Any] = RecentlyUsed(self._idle.append)
        self._latched: dict[str, tuple[Channel, bytes, zenoh.Timestamp]] = {}
        self._lock = threading.Lock()
        self._declared: list[Any] = []
        self._watchdog: ReceiveWatchdog | None = None
        self.duplicates = 0
        """Health messages from another process with this one's service and instance name."""

    def __enter__(self) -> Bus:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def announce(self, site: str, service: str, instance: str) -> None:
        """Declares a liveliness token while this bus is open, and counts health messages of namesakes."""
        address = {"site": site, "service": service, "instance": instance}
        self._declare_token(ALIVE_TEMPLATE.format(**address, contract=CONTRACT_VERSION))

        def on_health(_sample: Any) -> None:
            self.duplicates += 1

        self._declared.append(
            self._session.declare_subscriber(
                HEALTH.key(address), at_once(on_health), allowed_origin=zenoh.Locality.REMOTE
            )
        )

    def watch_others(self, watchdog: ReceiveWatchdog, site: str, service: str, instance: str) -> None:
        """Lets `watchdog` observe whether messages of other services of this instance name still arrive."""
        self._watchdog = watchdog
        self._declared += watchdog.attach(self._session, site, service, instance)

    @property
    def is_deaf(self) -> bool:
        """Whether messages of other services have stopped arriving. Must be read once a second."""
        return self._watchdog is not None and self._watchdog.is_lost(self._session)

    def look_for_links(self, interruptions: Interruptions, since_s: float) -> None:
        """Tells whom there is a link to, `since_s` after the last time."""
        with contextlib.suppress(RuntimeError, zenoh.ZError):  # another thread closes it just now
            info = self._session.info
            interruptions.look(map(str, info.routers_zid()), map(str, info.peers_zid()), since_s)

    def offer(self, channels: Sequence[Channel], address: Mapping[str, str]) -> None:
        """Answers queries for the newest samples of `channels` that are latched."""
        for channel in channels:
            if channel.qos.latched:
                for selector in selectors(channel, address):
                    self._declared.append(self._session.declare_queryable(selector, self._answer))
                self._declare_token(
                    LATCHED_TEMPLATE.format(
                        site=address["site"], channel=channel.name, session=self._session.zid()
                    )
                )

    def _declare_token(self, key: str) -> None:
        self._declared.append(self._session.liveliness().declare_token(key))

    def _answer(self, query: Any) -> None:
        with self._lock:
            held = [(key, *sample) for key, sample in self._latched.items()]
        had = digests_in(query.payload)
        with query, contextlib.suppress(zenoh.ZError):  # the asker is gone
            for key, channel, payload, stamp in held:
                if query.key_expr.intersects(key) and digest(payload) not in had:
                    query.reply(
                        key,
                        payload,
                        encoding=zenoh.Encoding(encoding(channel)),
                        timestamp=stamp,
                        express=channel.qos.express,
                    )

    def listen(
        self,
        channels: Sequence[Channel],
        address: Mapping[str, str],
        inbox: Inbox,
        known: Iterable[Arrival] = (),
        patient: Sequence[Channel] = (),
    ) -> None:
        """Fills `inbox` from all keys of `channels` that fit `address`; earlier samples of latched ones too.

        The robot in `address` may be a group. `known` samples, oldest first, are not requested again. Samples
        of `patient` channels wait until the inbox is looked into.
        """
        known = list(known)
        for channel in channels:
            intake = Intake([channel], inbox, known)
            for selector in selectors(channel, address):
                if channel in patient:
                    inbox.sources.append(self._wait_patiently(selector, intake))
                else:
                    # copying and digesting 10 MB would keep Zenoh's thread from the scans
                    self._subscribe(selector, intake, intake.on_sample if channel.qos.latched else None)
                if channel.qos.latched:
                    self._follow(channel, address.get("site", "*"), selector, intake, stagger(address))

    def listen_all(self, channels: Sequence[Channel], selector: str, inbox: Inbox) -> None:
        """Fills `inbox` from every key that `selector` matches; earlier samples of latched channels too."""
        intake = Intake(channels, inbox)
        self._subscribe(selector, intake)
        site = selector.partition("/")[0].replace("**", "*")
        for channel in channels:
            past = channel.selector({"site": site})
            if channel.qos.latched and zenoh.KeyExpr(selector).intersects(past):
                self._follow(channel, site, past, intake)

    def _subscribe(self, selector: str, intake: Intake, handler: Any = None) -> Any:
        origin = zenoh.Locality.ANY
        if self._exchange is not None:
            origin = zenoh.Locality.REMOTE
            self._exchange.listen(selector, intake)
        if handler is None:
            handler = intake.on_sample if self._publishes_inside else at_once(intake.on_sample)
        subscriber: Any = self._session.declare_subscriber(selector, handler, allowed_origin=origin)
        self._declared.append(subscriber)
        return subscriber

    def _wait_patiently(self, selector: str, intake: Intake) -> Callable[[], None]:
        """Subscribes without a callback; returns what takes the samples that wait."""
        subscriber = self._subscribe(selector, intake, zenoh.handlers.RingChannel(MOST_PATIENT))

        def take() -> None:
            try:
                while (sample := subscriber.try_recv()) is not None:
                    intake.take_live(sample)
            except zenoh.ZError:
                return  # the subscriber is undeclared

        return take

    def _follow(
        self, channel: Channel, site: str, selector: str, intake: Intake, patience_s: float = 0.0
    ) -> None:
        """Queries the newest samples of `channel` at each new token of a publisher.

        If some are held already, the query lists them and waits `patience_s` first.
        """

        def on_token(token: Any) -> None:
            stands = token.kind == zenoh.SampleKind.PUT
            if not intake.on_token(str(token.key_expr).rpartition("/")[2], stands=stands):
                return
            if intake.digests() and patience_s:
                self._after(patience_s, ask)
            else:
                ask()

        def ask() -> None:
            with contextlib.suppress(zenoh.ZError):  # the session is closed
                self._session.get(
                    selector,
                    intake.on_reply,
                    payload=b"".join(intake.digests()) or None,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    timeout=LATCHED_TIMEOUT_S,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=_PRIORITY[channel.qos.priority],
                )

        # not in the thread that puts samples, which may be Zenoh's own
        intake.ask_again[channel.name] = lambda: self._after(patience_s, ask)
        tokens = LATCHED_TEMPLATE.format(site=site, channel=channel.name, session="*")
        self._declared.append(self._session.liveliness().declare_subscriber(tokens, on_token, history=True))

    def publish(self, envelope: Envelope) -> None:
        """Publishes one message with its channel's quality of service."""
        channel, key = envelope.channel, envelope.key
        payload = encode(envelope.message)
        stamp = None
        with self._lock:
            if channel.qos.latched:
                stamp = self._session.new_timestamp()
                self._latched[key] = (channel, payload, stamp)
            publisher = self._publishers.use(key, lambda: self._publisher(channel, key))
            idle = self._idle.copy()
            self._idle.clear()
        if self._exchange is not None:
            self._exchange.hand(channel, key, envelope.message, payload, stamp)
        publisher.put(payload, timestamp=stamp)
        for one in idle:  # publishers for robots that are gone
            one.undeclare()

    def wait_for_listener(self, key: str, timeout: float) -> bool:
        """Waits for a subscriber to `key`, at most `timeout` seconds; False without one."""
        publisher: Any = self._session.declare_publisher(key)  # the stub of matching_status is wrong
        try:
            deadline = time.monotonic() + timeout
            while not publisher.matching_status.matching:
                if time.monotonic() >= deadline:
                    return False
                time.sleep(LISTENER_POLL_S)
            return True
        finally:
            publisher.undeclare()

    def _publisher(self, channel: Channel, key: str) -> Any:
        block = channel.qos.block
        return self._session.declare_publisher(
            key,
            encoding=zenoh.Encoding(encoding(channel)),
            priority=_PRIORITY[channel.qos.priority],
            express=channel.qos.express,
            congestion_control=zenoh.CongestionControl.BLOCK if block else zenoh.CongestionControl.DROP,
        )

    def close(self) -> None:
        """Undeclares everything and closes the session, unless it is shared. Later publications fail."""
        with self._lock:
            declared = [*self._declared, *(publisher for _, publisher in self._publishers.items())]
            self._declared.clear()
            self._publishers = RecentlyUsed()
        for one in declared:
            with contextlib.suppress(zenoh.ZError):  # the link may be gone already
                one.undeclare()
        if self._exchange is None:
            self._session.close()


def stagger(address: Mapping[str, str]) -> float:
    """Seconds that a robot waits before it queries again, derived from its name; 0 for a whole site."""
    robot = address.get("robot", "")
    return STAGGER_S * zlib.crc32(robot.encode()) / 2**32 if robot else 0.0
