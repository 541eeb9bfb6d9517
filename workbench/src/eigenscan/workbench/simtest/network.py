"""Zenoh as the runtime uses it, simulated: sessions on machines, links between them that fail.

A message on a link that stands comes in order, after a delay. One that may be dropped is lost where the link
does not pass it; one that may not waits for as long as the link is held for standing, as over TCP.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from hashlib import blake2b
from random import Random
from typing import TYPE_CHECKING, Any

import zenoh
from eigenscan.runtime.intake import Intake
from eigenscan.schemas.channels import Channel, Role, find
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock

if TYPE_CHECKING:
    from eigenscan.workbench.simtest.process import Process

LEASE_S = 10.0
"""Zenoh's own: a link that passes nothing for so long is given up."""
RECONNECT_S = 4.0
"""Zenoh's longest pause between two attempts to connect."""
LOCAL_S = 0.0005
"""From process to process on one machine."""

expression = lru_cache(maxsize=65536)(zenoh.KeyExpr)
channel_of = lru_cache(maxsize=65536)(find)


class Bytes(bytes):
    """A payload."""

    def to_bytes(self) -> bytes:
        """As Zenoh's."""
        return self


NOTHING = Bytes()


@dataclass(frozen=True, order=True)
class Timestamp:
    """Time and session."""

    time: int
    own: str

    def get_id(self) -> str:
        """Whose it is."""
        return self.own


@dataclass(frozen=True)
class Sample:
    """What a subscriber gets."""

    key_expr: str
    payload: Bytes = NOTHING
    encoding: Any = ""
    timestamp: Timestamp | None = None
    kind: Any = field(default_factory=lambda: zenoh.SampleKind.PUT)


@dataclass(frozen=True)
class Reply:
    """What a query gets."""

    ok: Sample | None
    err: str = ""


@dataclass
class Link:
    """What is between two machines, or within one."""

    delay_s: float
    jitter_s: float
    random: Random
    passes: bool = True
    stands: bool = True
    """As both ends see it."""
    loss: float = 0.0
    """Share that is lost of what may be dropped."""
    extra_s: float = 0.0
    disorder_s: float = 0.0
    """By which messages may overtake others."""
    duplication: float = 0.0
    held: deque[Callable[[], None]] = field(default_factory=deque)
    latest_ns: dict[tuple[str, str], int] = field(default_factory=dict)


class Declared:
    """A subscriber, a queryable or a token, until it is undeclared."""

    def __init__(self, session: Session, key: str, callback: Any = None, **more: Any) -> None:
        if isinstance(callback, zenoh.handlers.Callback):  # in whose thread makes no difference here
            callback = callback.callback.__wrapped__  # type: ignore[attr-defined]
        self.session, self.key, self.callback, self.more = session, key, callback, more
        self.expression = expression(key)
        self.seen: set[str] = set()
        """Of a subscriber to tokens: those that are there."""
        self.waiting: deque[Sample] = deque()
        """Of a subscriber without a callback: what `try_recv` takes."""
        self.fills_inbox = isinstance(getattr(callback, "__self__", None), Intake)
        self.is_patient = isinstance(callback, zenoh.handlers.RingChannel)
        """Whether what arrives waits until the service looks, and wakes nobody at once."""
        if self.is_patient:
            self.callback = self.waiting.append

    def try_recv(self) -> Sample | None:
        """The oldest sample that waits; only now it is in the inbox."""
        if not self.waiting:
            return None
        sample = self.waiting.popleft()
        self.session.note_arrived(sample.key_expr)
        return sample

    def undeclare(self) -> None:
        """Ends it."""
        self.session.network.forget(self)


class Publisher:
    """Puts on one key."""

    def __init__(self, session: Session, key: str, reported: Any, *, block: bool) -> None:
        self._session, self._key, self._encoding, self._block = session, key, reported, block

    def put(self, payload: bytes, timestamp: Timestamp | None = None) -> None:
        """Publishes."""
        if not self._session.is_open:
            return
        translated = self._session.translate(self._key, payload)
        if translated is not None:
            sample = Sample(self._key, Bytes(translated), self._encoding, timestamp)
            self._session.network.publish(self._session, sample, block=self._block)

    def undeclare(self) -> None:
        """Nothing to undo."""


class Query:
    """At a queryable."""

    def __init__(self, session: Session, key: str, payload: bytes | None, answer: Callable[[Reply], None]):
        self.session, self.key_expr = session, expression(key)
        self.payload = None if payload is None else Bytes(payload)
        self._answer = answer

    def __enter__(self) -> Query:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def reply(self, key: Any, payload: bytes, encoding: Any = "", timestamp: Any = None, **_: Any) -> None:
        """Sends an answer."""
        translated = self.session.translate(str(key), payload)
        if translated is not None:
            self._answer(Reply(Sample(str(key), Bytes(translated), encoding, timestamp)))

    def reply_err(self, payload: str) -> None:
        """Sends an error."""
        self._answer(Reply(None, payload))


class Session:
    """One process's, as the runtime's Bus uses zenoh.Session."""

    def __init__(self, network: Network, machine: str, number: int, clock: MachineClock) -> None:
        self.network, self.machine, self._clock = network, machine, clock
        self.name = f"{number:08x}"
        self.is_open = True
        self.is_silent = False
        """It stands, but nothing arrives any more."""
        self.arrived: Counter[str] = Counter()
        """What was handed to the inbox, by channel."""
        self.owner: Process | None = None
        """The service's process; None: a driver or a stranger."""
        self.translate: Callable[[str, bytes], bytes | None] = lambda _key, payload: payload
        """What a service of another release publishes instead; None: nothing."""
        self._stamped = 0
        self.info = self

    def note_arrived(self, key: str) -> None:
        """Counts what is handed to the inbox."""
        found = channel_of(key)
        self.arrived[found[0].name if found else "foreign_key"] += 1

    def zid(self) -> str:
        """Its name."""
        return self.name

    def routers_zid(self) -> list[str]:
        """None: peers are enough to show a link."""
        return []

    def peers_zid(self) -> list[str]:
        """Whom it is linked to: those of its machine always."""
        return [each.name for each in self.network.sessions if each is not self]

    def is_closed(self) -> bool:
        """Whether it was closed."""
        return not self.is_open

    def new_timestamp(self) -> Timestamp:
        """Later than all before it."""
        self._stamped = max(self._stamped + 1, self._clock.time_ns())
        return Timestamp(self._stamped, self.name)

    def declare_publisher(
        self, key: str, encoding: Any = "", congestion_control: Any = None, **_: Any
    ) -> Any:
        """Of one key."""
        block = congestion_control == zenoh.CongestionControl.BLOCK
        return Publisher(self, key, str(encoding), block=block)

    def declare_subscriber(self, key: str, callback: Any, allowed_origin: Any = zenoh.Locality.ANY) -> Any:
        """To all keys that fit."""
        remote = allowed_origin == zenoh.Locality.REMOTE
        return self.network.subscribe(Declared(self, key, callback, remote=remote))

    def declare_queryable(self, key: str, callback: Any, **_: Any) -> Any:
        """For all keys that fit."""
        return self.network.offer(Declared(self, key, callback))

    def liveliness(self) -> Session:
        """Tokens."""
        return _Liveliness(self)  # type: ignore[return-value]

    def get(
        self, selector: str, handler: Any, payload: bytes | None = None, timeout: float = 10.0, **_: Any
    ) -> None:
        """Asks all who answer."""
        self.network.ask(self, str(selector), handler, payload, timeout)

    def close(self) -> None:
        """Ends all of it."""
        self.network.close(self)


class _Liveliness:
    def __init__(self, session: Session) -> None:
        self._session = session

    def declare_token(self, key: str) -> Declared:
        return self._session.network.show(Declared(self._session, key))

    def declare_subscriber(self, key: str, callback: Any, **_: Any) -> Declared:
        return self._session.network.watch(Declared(self._session, key, callback))

    def get(self, _key: str, handler: Callable[[Reply], None], timeout: float) -> None:
        """A router answers at once, which a session that receives nothing does not learn."""
        self._session.network.time_out(self._session, handler, timeout)


class Network:
    """All sessions of a site, and the links between its machines."""

    def __init__(self, agenda: Agenda, seed: str) -> None:
        self._agenda, self._seed = agenda, seed
        self.sessions: list[Session] = []
        self.links: dict[tuple[str, str], Link] = {}
        self.observer: Callable[[Session, Sample], None] = lambda _session, _sample: None
        """Sees everything that is published."""
        self.arrived: Callable[[Session, bool], None] = lambda _session, _is_patient: None
        """Called after something was handed to a session, and whether it may wait."""
        self.trace = blake2b(digest_size=16)
        self.sent = 0
        self._number = 0
        self._subscribers: list[Declared] = []
        self._queryables: list[Declared] = []
        self._tokens: list[Declared] = []
        self._watchers: list[Declared] = []
        self._routes: dict[str, list[Declared]] = {}
        self._crossed: dict[tuple[str, str], int] = {}

    def open(self, machine: str, clock: MachineClock) -> Session:
        """A session of a process."""
        self._number += 1
        session = Session(self, machine, self._number, clock)
        self.sessions.append(session)
        return session

    def close(self, session: Session) -> None:
        """The process is gone, or has closed it."""
        session.is_open = False
        self.sessions.remove(session) if session in self.sessions else None
        for group in (self._subscribers, self._queryables, self._tokens, self._watchers):
            group[:] = [each for each in group if each.session is not session]
        self._routes.clear()
        self._show_tokens()

    def forget(self, declared: Declared) -> None:
        """Something is undeclared."""
        for group in (self._subscribers, self._queryables, self._tokens, self._watchers):
            if declared in group:
                group.remove(declared)
        self._routes.clear()
        self._show_tokens()

    def subscribe(self, one: Declared) -> Declared:
        """A subscriber."""
        self._subscribers.append(one)
        self._routes.clear()
        return one

    def offer(self, one: Declared) -> Declared:
        """A queryable."""
        self._queryables.append(one)
        return one

    def show(self, one: Declared) -> Declared:
        """A token."""
        self._tokens.append(one)
        self._show_tokens()
        return one

    def watch(self, one: Declared) -> Declared:
        """A subscriber to tokens, which learns of those that are there."""
        self._watchers.append(one)
        self._show_tokens()
        return one

    def link(self, one: str, other: str) -> Link:
        """Between two machines, or within one."""
        pair = (min(one, other), max(one, other))
        if pair not in self.links:
            random = Random(f"{self._seed} link {pair}")
            local = one == other
            delay = LOCAL_S if local else random.uniform(0.002, 0.03)
            self.links[pair] = Link(delay, 0.2 * delay, random)
        return self.links[pair]

    def publish(self, session: Session, sample: Sample, *, block: bool) -> None:
        """To all who subscribe and may receive it."""
        self.observer(session, sample)
        self.sent += 1
        self.trace.update(
            f"{self._agenda.now_ns} {session.name} {sample.key_expr} ".encode() + sample.payload
        )
        route = self._routes.get(sample.key_expr)
        if route is None:
            key = expression(sample.key_expr)
            route = [each for each in self._subscribers if each.expression.intersects(key)]
            self._routes[sample.key_expr] = route
        by_session: defaultdict[Session, list[Declared]] = defaultdict(list)
        for each in route:
            if each.session is session:
                if not each.more["remote"]:
                    self._deliver(each, sample)
            else:
                by_session[each.session].append(each)
        crossing: dict[str, bool] = {}
        for to, receivers in by_session.items():
            if to.machine != session.machine:
                if to.machine not in crossing:
                    crossing[to.machine] = self._may_cross(session.machine, to.machine, sample.key_expr)
                if not crossing[to.machine]:
                    continue
            self._send(session, to, partial(self._deliver_all, receivers, sample), block=block)

    def _may_cross(self, machine: str, to: str, key: str) -> bool:
        """What a site's routers let through, and how often."""
        found = channel_of(key)
        if found is None or "site" not in (machine, to):
            return False
        channel: Channel = found[0]
        if machine == "site":
            own = found[1].get("robot", to) == to
            return (
                own
                and Role.ROBOT in channel.received_by
                and any(r is not Role.ROBOT for r in channel.published_by)
            )
        if channel.qos.air_hz == 0.0:
            return False
        last, now = self._crossed.get((to, key)), self._agenda.now_ns
        if last is not None and now - last < 1e9 / channel.qos.air_hz:
            return False
        self._crossed[to, key] = now
        return True

    def _deliver_all(self, receivers: list[Declared], sample: Sample) -> None:
        for each in receivers:
            self._deliver(each, sample)

    def _deliver(self, receiver: Declared, sample: Sample) -> None:
        session = receiver.session
        if not session.is_open or session.is_silent:
            return
        if receiver.fills_inbox:
            session.note_arrived(sample.key_expr)
        receiver.callback(sample)
        self.arrived(session, receiver.is_patient)

    def _send(self, session: Session, to: Session, action: Callable[[], None], *, block: bool) -> None:
        """Over the link between two sessions."""
        link = self.link(session.machine, to.machine)
        if not link.passes or not link.stands:
            if block and link.stands:
                link.held.append(lambda: self._travel(link, session, to, action))
            return
        if not block and link.loss and link.random.random() < link.loss:
            return
        self._travel(link, session, to, action)
        if link.duplication and link.random.random() < link.duplication:
            self._travel(link, session, to, action)

    def _travel(self, link: Link, session: Session, to: Session, action: Callable[[], None]) -> None:
        seconds = link.delay_s + link.extra_s + link.jitter_s * link.random.random()
        due = self._agenda.now_ns + round(seconds * 1e9)
        pair = (session.machine, to.machine)  # their routers share one connection
        if session.machine == to.machine:
            pair = (session.name, to.name)
        if link.disorder_s:
            due += round(link.random.random() * link.disorder_s * 1e9)
        else:
            due = max(due, link.latest_ns.get(pair, 0))
        link.latest_ns[pair] = max(due, link.latest_ns.get(pair, 0))
        self._agenda.after((due - self._agenda.now_ns) * 1e-9, action)

    def cut(self, link: Link) -> None:
        """From now on it passes nothing."""
        link.passes = False

        def give_up() -> None:
            if not link.passes:
                link.stands = False
                link.held.clear()
                self._show_tokens()

        self._agenda.after(LEASE_S, give_up)

    def mend(self, link: Link) -> None:
        """It passes again what comes, after a new attempt to connect where it was given up."""
        link.passes = True
        if link.stands:
            held, link.held = link.held, deque()
            for each in held:
                each()
            return

        def connect() -> None:
            if link.passes:
                link.stands = True
                self._show_tokens()

        self._agenda.after(RECONNECT_S * link.random.random(), connect)

    def _show_tokens(self) -> None:
        """Shows each watcher which tokens came and went, as far as its links reach."""
        for watcher in list(self._watchers):
            there = {
                token.key
                for token in self._tokens
                if token.expression.intersects(watcher.expression)
                and self.link(token.session.machine, watcher.session.machine).stands
            }
            for key in sorted(watcher.seen - there):
                self._report(watcher, Sample(key, kind=zenoh.SampleKind.DELETE))
            for key in sorted(there - watcher.seen):
                self._report(watcher, Sample(key))
            watcher.seen = there

    def _report(self, watcher: Declared, sample: Sample) -> None:
        def report() -> None:
            if watcher.session.is_open and not watcher.session.is_silent:
                watcher.callback(sample)

        self._agenda.after(LOCAL_S, report)

    def time_out(self, session: Session, handler: Callable[[Reply], None], timeout: float) -> None:
        """The end of a query whose answer does not come."""
        if session.is_silent:
            self._agenda.after(timeout, lambda: handler(Reply(None, "timeout")) if session.is_open else None)

    def ask(
        self, session: Session, selector: str, handler: Any, payload: bytes | None, timeout: float
    ) -> None:
        """A query to all whose keys fit; without an answer for `timeout` s, the news of that."""
        wanted = expression(selector)
        open_queries = 0

        def done() -> None:
            nonlocal open_queries
            open_queries -= 1

        def receive(reply: Reply) -> None:
            if session.is_open and not session.is_silent:
                if reply.ok is not None:
                    session.note_arrived(reply.ok.key_expr)
                else:
                    session.arrived["unanswered"] += 1
                handler(reply)
                self.arrived(session, False)

        def question(one: Declared) -> Callable[[], None]:
            def put() -> None:
                if not one.session.is_open:
                    return
                answers: list[Reply] = []
                one.callback(Query(one.session, selector, payload, answers.append))

                def bring() -> None:
                    for each in answers:
                        receive(each)
                    done()

                self._send(one.session, session, bring, block=True)

            return put

        for one in [each for each in self._queryables if each.expression.intersects(wanted)]:
            open_queries += 1
            if one.session is session:
                question(one)()
            else:
                self._send(session, one.session, question(one), block=True)

        def give_up() -> None:
            if open_queries:
                receive(Reply(None, "timeout"))

        if open_queries:
            self._agenda.after(timeout, give_up)
