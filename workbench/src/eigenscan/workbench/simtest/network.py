"""Zenoh as the runtime uses it, simulated: sessions on machines, links between them that fail.

A message on a link that stands comes in order, after a delay. One that may be dropped is lost where the link
does not pass it; one that may not waits for as long as the link is held for standing, as over TCP.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from hashlib import blake2b
from random import Random
from typing import Any, NamedTuple

import zenoh
from eigenscan.schemas.channels import Channel, Role
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock
from eigenscan.workbench.simtest.session import (
    Declared,
    Query,
    Reply,
    Sample,
    Session,
    channel_of,
    expression,
)

LEASE_S = 10.0
"""Zenoh's own: a link that passes nothing for so long is given up."""
RECONNECT_S = 4.0
"""Zenoh's longest pause between two attempts to connect."""
LOCAL_S = 0.0005
"""From process to process on one machine."""


@dataclass
class Link:
    """What is between two machines, or within one."""

    delay_s: float
    jitter_s: float
    random: Random
    passes: bool = True
    stands: bool = True
    """As both ends see it."""
    cuts: int = 0
    loss: float = 0.0
    """Share that is lost of what may be dropped."""
    extra_s: float = 0.0
    disorder_s: float = 0.0
    """By which messages may overtake others."""
    duplication: float = 0.0
    held: deque[Callable[[], None]] = field(default_factory=deque)
    latest_ns: dict[tuple[str, str], int] = field(default_factory=dict)


class Way(NamedTuple):
    """From a session to another one."""

    link: Link
    pair: tuple[str, str]
    """Whose messages keep their order: two machines', as their routers share a link; or two sessions'."""


class Route(NamedTuple):
    """To the subscribers of one session, for one key."""

    receivers: list[Declared]
    way: Way | None
    """None: its own session."""
    machine: str
    """Another one, where it has to cross."""
    period_ns: float
    """Between two that cross."""


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
        self._routes: dict[tuple[Session, str], list[Route]] = {}
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
        key = sample.key_expr
        self.observer(session, sample)
        self.sent += 1
        self.trace.update(f"{self._agenda.now_ns} {session.name} {key} ".encode())
        self.trace.update(sample.payload)
        routes = self._routes.get((session, key))
        if routes is None:
            routes = self._routes[session, key] = self._routes_of(session, key)
        crossing: dict[str, bool] = {}
        for receivers, way, machine, period_ns in routes:
            if way is None:
                self._deliver_all(receivers, sample)
                continue
            if machine:
                if machine not in crossing:
                    crossing[machine] = self._may_cross(machine, key, period_ns)
                if not crossing[machine]:
                    continue
            self._send(way, partial(self._deliver_all, receivers, sample), block=block)

    def _routes_of(self, session: Session, key: str) -> list[Route]:
        """Its own session first."""
        by_session: dict[Session, list[Declared]] = {session: []}
        wanted = expression(key)
        for each in self._subscribers:
            own = each.session is session
            if each.expression.intersects(wanted) and not (own and each.more["remote"]):
                by_session.setdefault(each.session, []).append(each)
        routes = []
        for to, receivers in by_session.items():
            if to is session:
                routes.append(Route(receivers, None, "", 0.0))
                continue
            crosses = to.machine != session.machine
            hertz = self._crosses_hz(session.machine, to.machine, key) if crosses else math.inf
            if hertz:
                machine = to.machine if crosses else ""
                routes.append(Route(receivers, self._way(session, to), machine, 1e9 / hertz))
        return routes

    def _crosses_hz(self, machine: str, to: str, key: str) -> float:
        """How often a site's routers let a key through; 0: never."""
        found = channel_of(key)
        if found is None or "site" not in (machine, to):
            return 0.0
        channel: Channel = found[0]
        if machine == "site":
            own = found[1].get("robot", to) == to
            is_for_robots = Role.ROBOT in channel.received_by and any(
                r is not Role.ROBOT for r in channel.published_by
            )
            return math.inf if own and is_for_robots else 0.0
        return channel.qos.air_hz

    def _may_cross(self, to: str, key: str, period_ns: float) -> bool:
        """Whether the last one crossed long enough ago."""
        if not period_ns:
            return True
        last, now = self._crossed.get((to, key)), self._agenda.now_ns
        if last is not None and now - last < period_ns:
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

    def _way(self, session: Session, to: Session) -> Way:
        link = self.link(session.machine, to.machine)
        if session.machine == to.machine:
            return Way(link, (session.name, to.name))
        return Way(link, (session.machine, to.machine))

    def _send(self, way: Way, action: Callable[[], None], *, block: bool) -> None:
        """Over the link between two sessions."""
        link = way.link
        if not link.passes or not link.stands:
            if block and link.stands:
                link.held.append(lambda: self._travel(way, action))
            return
        if not block and link.loss and link.random.random() < link.loss:
            return
        self._travel(way, action)
        if link.duplication and link.random.random() < link.duplication:
            self._travel(way, action)

    def _travel(self, way: Way, action: Callable[[], None]) -> None:
        link, pair = way
        seconds = link.delay_s + link.extra_s + link.jitter_s * link.random.random()
        due = self._agenda.now_ns + round(seconds * 1e9)
        latest = link.latest_ns.get(pair, 0)
        if link.disorder_s:
            due += round(link.random.random() * link.disorder_s * 1e9)
        elif due < latest:
            due = latest
        if due > latest:
            link.latest_ns[pair] = due
        self._agenda.at(due, action)

    def cut(self, link: Link) -> None:
        """From now on it passes nothing."""
        if not link.passes:
            return
        link.passes = False
        link.cuts += 1
        number = link.cuts

        def give_up() -> None:
            if not link.passes and link.cuts == number:
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
        """A query to all whose keys fit; without an answer for `timeout` s, the news of that, and no more."""
        wanted = expression(selector)
        unanswered: set[Declared] = set()
        is_over = False

        def receive(reply: Reply) -> None:
            if session.is_open and not session.is_silent and not is_over:
                if reply.ok is not None:
                    session.note_arrived(reply.ok.key_expr)
                else:
                    session.arrived["unanswered"] += 1
                handler(reply)
                self.arrived(session, False)

        def question(one: Declared) -> Callable[[], None]:
            def put() -> None:
                if not one.session.is_open or one.session.is_silent:
                    return
                answers: list[Reply] = []
                one.callback(Query(one.session, selector, payload, answers.append))

                def bring() -> None:
                    for each in answers:
                        receive(each)
                    unanswered.discard(one)

                self._send(self._way(one.session, session), bring, block=True)

            return put

        for one in [each for each in self._queryables if each.expression.intersects(wanted)]:
            unanswered.add(one)
            if one.session is session:
                question(one)()
            else:
                self._send(self._way(session, one.session), question(one), block=True)

        def give_up() -> None:
            nonlocal is_over
            if unanswered:
                receive(Reply(None, "timeout"))
            is_over = True

        if unanswered:
            self._agenda.after(timeout, give_up)
