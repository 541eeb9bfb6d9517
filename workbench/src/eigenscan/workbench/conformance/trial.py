"""One run of a candidate: started late, played a drive, fed nonsense, played the rest, asked to stop."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path

import zenoh
from eigenscan.eigenspace.model import set_version
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, MODEL_SET, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.workbench.conformance.bad_input import bad_samples
from eigenscan.workbench.conformance.candidate import Candidate
from eigenscan.workbench.conformance.check import Check
from eigenscan.workbench.conformance.profiles import Profile
from eigenscan.workbench.conformance.receiving import Ear, Received, alive_key
from eigenscan.workbench.conformance.recording import LOST_S, Published
from eigenscan.workbench.conformance.vectors import Vectors
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Timed

FIRST_SHARE = 0.7
"""Share of the drive before the nonsense; the rest comes after it."""
BETWEEN_BAD_S = 0.05
TOKEN_S = 3.0
"""Longest time between a service's token and its first health, in either order, s."""
COUNTED_S = 5.0
TAKEN_IN_S = 1.0
"""Time for a recorder to take the last messages before it is ended, s."""


@dataclass(frozen=True)
class Terms:
    """Limits of a trial; s, except `speed` and `patience`."""

    start_s: float = 60.0
    settle_s: float = 3.0
    """Silence after which no more answers are awaited."""
    speed: float = 1.0
    patience: float = 1.0
    """Factor on all other time limits except the start, for a busy machine."""


@dataclass
class Observed:
    """All that was seen of a candidate."""

    profile: Profile
    vectors: Vectors
    address: dict[str, str]
    instance: str
    received: list[Received] = field(default_factory=list)
    tokens: dict[str, tuple[float, float | None]] = field(default_factory=dict)
    asked: dict[tuple[str, int], float] = field(default_factory=dict)
    """Publication time of each message that needs an answer: monotonic s by lidar and stamp."""
    asked_again: set[tuple[str, int]] = field(default_factory=set)
    """Those of them that came after the nonsense."""
    started_at: float = 0.0
    ready: bool = False
    ended_early: str = ""
    """Its exit code and the moment, if it ended by itself."""
    undecodable: int = 0
    """Bad samples that it has to count."""
    counted_before: int = 0
    counted: int = 0
    other_set: str = ""
    """Version of the set of models that was published while it ran."""
    joined: dict[str, tuple[Channel, bytes]] = field(default_factory=dict)
    """Latched messages that a late subscriber received, by key."""
    published: list[Published] = field(default_factory=list)
    """All published messages that it could receive, without nonsense."""
    kept: list[Check] = field(default_factory=list)
    """Checks of a recorder's files."""
    stopped: tuple[int | None, float] | None = None
    stopped_at: float = 0.0
    last_lines: list[str] = field(default_factory=list)

    @property
    def wanted(self) -> set[tuple[Channel, int, str]]:
        """The expected answers: channel, stamp, and lidar if the channel's key names it."""
        return {
            (channel, stamp, lidar if "lidar" in channel.fields else "")
            for channel in self.profile.answers
            for lidar, stamp in self.asked
        }


class Trial:
    """Runs a candidate, the only other peer of a session."""

    def __init__(self, session: zenoh.Session, others: Path, seen: Observed, terms: Terms) -> None:
        """`others` is the Zenoh configuration with which one meets `session`."""
        self._session, self._others, self._seen, self._terms = session, others, seen, terms
        self._site = seen.address["site"]
        self._ear = Ear(session, self._site)
        self._bus = Bus(session)
        self._newest: dict[str, Envelope] = {}
        self._token_s = TOKEN_S * terms.patience

    @contextmanager
    def prepared(self) -> Iterator[None]:
        """Publishes the messages that a late subscriber has to fetch. An error ends that, too."""
        self._bus.offer(self._seen.profile.latched, self._seen.address)
        try:
            for envelope in self._seen.vectors.latched:
                self._publish(envelope)
            yield
        except BaseException:  # such as a candidate that cannot be started
            self._bus.close()
            raise

    def run(self, candidate: Candidate) -> Observed:
        """Everything, from the candidate's start to its end."""
        seen = self._seen
        seen.started_at = time.monotonic()
        before, after = seen.vectors.parts(FIRST_SHARE)
        self._await_start(candidate)
        if seen.profile.records and candidate.lives:
            self._play(before, candidate, "the first part of the drive")
            if candidate.lives:
                self._publish_nonsense(candidate)
                self._play(after, candidate, "the rest of the drive")
            time.sleep(TAKEN_IN_S * self._terms.patience)
        elif seen.profile.asks is None:
            self._join_late()
        elif candidate.lives:
            self._play(before, candidate, "the first part of the drive")
            if candidate.lives:
                self._publish_nonsense(candidate)
                self._publish_other_set()
                self._play(after, candidate, "the rest of the drive")
        if candidate.lives:
            seen.stopped = candidate.terminate(self._terms.patience)
            seen.stopped_at = time.monotonic()
            token = alive_key(self._site, seen.profile.name, seen.instance)
            self._ear.wait_for(
                lambda: self._ear.tokens().get(token, (0.0, 0.0))[1] is not None, self._token_s
            )
        elif not seen.ended_early:
            seen.ended_early = candidate.obituary
        seen.received, seen.tokens, seen.last_lines = (
            self._ear.received(),
            self._ear.tokens(),
            candidate.last_lines,
        )
        if not seen.profile.records:
            self._bus.close()
        return seen

    def kill(self, candidate: Candidate) -> int:
        """Plays a drive to a new recorder process and kills it; returns the time, ns since the epoch."""
        known = len(self._ear.received())
        self._ear.wait_for(
            lambda: len(self._ear.received()) > known or not candidate.lives, self._terms.start_s
        )
        self._seen.published = []
        self._play(self._seen.vectors.parts(FIRST_SHARE)[0], candidate, "the drive before a kill")
        time.sleep(LOST_S * (self._terms.patience - 1.0))
        candidate.kill()
        killed = time.time_ns()
        self._bus.close()
        return killed

    def _await_start(self, candidate: Candidate) -> None:
        """Waits for a health without missing parts, or for a token without health."""
        ear, needs_models = self._ear, bool(self._seen.profile.latched) or self._seen.profile.asks is None

        def is_ready() -> bool:
            health = ear.health()
            return health is not None and (health.status == Health.STATUS_OK or not needs_models)

        def is_there() -> bool:
            return bool(ear.tokens()) or ear.health() is not None or not candidate.lives

        ear.wait_for(is_there, self._terms.start_s)
        if candidate.lives and ear.wait_for(lambda: ear.health() is not None, self._token_s):
            ear.wait_for(lambda: is_ready() or not candidate.lives, self._terms.start_s)
        self._seen.ready = is_ready()
        ear.wait_for(lambda: bool(ear.tokens()) or not candidate.lives, self._token_s)
        if not candidate.lives:
            self._seen.ended_early = f"{candidate.obituary} (at its start)"

    def _play(self, messages: list[Timed], candidate: Candidate, about: str) -> None:
        first = {timed.envelope.key for timed in messages}
        for key in sorted(first):
            self._bus.wait_for_listener(key, self._token_s)
        publish(messages, self._ask, self._terms.speed)
        self._settle(candidate)
        if not candidate.lives and not self._seen.ended_early:
            self._seen.ended_early = f"{candidate.obituary} (during {about})"

    def _ask(self, envelope: Envelope) -> None:
        seen = self._seen
        if envelope.channel is seen.profile.asks:
            question = (envelope.address["lidar"], envelope.stamp)
            seen.asked[question] = time.monotonic()
            if seen.undecodable:
                seen.asked_again.add(question)
        self._newest[envelope.key] = envelope
        self._publish(envelope)

    def _publish(self, envelope: Envelope) -> None:
        self._seen.published.append(Published(envelope, time.time_ns()))
        self._bus.publish(envelope)

    def _settle(self, candidate: Candidate) -> None:
        """Until each question has its answers, or nothing but health comes for a while."""
        wanted = self._seen.wanted
        counted, quiet_since = -1, time.monotonic()
        while (
            candidate.lives and time.monotonic() - quiet_since < self._terms.settle_s * self._terms.patience
        ):
            received = [one for one in self._ear.received() if one.channel is not HEALTH]
            if wanted <= {(one.channel, one.stamp, one.address.get("lidar", "")) for one in received}:
                return
            if len(received) != counted:
                counted, quiet_since = len(received), time.monotonic()
            time.sleep(0.05)

    def _publish_nonsense(self, candidate: Candidate) -> None:
        """All bad samples, one by one; then waits until those that it has to count are counted."""
        seen = self._seen
        seen.counted_before = self._counted()
        for bad in bad_samples(list(self._newest.values())):
            if bad.payload is None:
                self._session.delete(bad.key)
            else:
                self._session.put(bad.key, bad.payload, encoding=zenoh.Encoding(bad.encoding))
            seen.undecodable += bad.undecodable
            time.sleep(BETWEEN_BAD_S)
            if not candidate.lives:
                seen.ended_early = f"{candidate.obituary} (after {bad.about} on {bad.key})"
                return
        wanted = seen.counted_before + seen.undecodable
        self._ear.wait_for(
            lambda: self._counted() >= wanted or not candidate.lives, COUNTED_S * self._terms.patience
        )
        seen.counted = self._counted()
        if not candidate.lives:
            seen.ended_early = f"{candidate.obituary} (after bad input)"

    def _counted(self) -> int:
        health = self._ear.health()
        return health.counters.get("undecodable", 0) if health else 0

    def _publish_other_set(self) -> None:
        """The same models as a set of another version, in another order."""
        for envelope in self._seen.vectors.latched:
            if envelope.channel is MODEL_SET:
                other = deepcopy(envelope.open(ModelSet))
                del other.entries[:]
                other.entries.extend(reversed(envelope.open(ModelSet).entries))
                other.version = set_version(other.map_version, [entry.version for entry in other.entries])
                self._seen.other_set = other.version
                self._bus.publish(Envelope(MODEL_SET, envelope.address, other))
                time.sleep(1.0)

    def _join_late(self) -> None:
        """Receives latched channels as one that comes when all is published."""
        inbox, channels = Inbox(), self._seen.profile.outputs
        with Bus(open_session(self._others)) as late:
            late.listen(channels, {"site": self._site}, inbox)
            deadline = time.monotonic() + self._terms.settle_s * self._terms.patience + self._token_s
            while time.monotonic() < deadline and not self._is_whole():
                arrival = inbox.take(0.1)
                if arrival:
                    self._seen.joined[arrival.key] = arrival.channel, arrival.payload

    def _is_whole(self) -> bool:
        """Whether the late one has the map, the newest set, and as many models as that names."""
        sets = [one.message for one in self._ear.received() if isinstance(one.message, ModelSet)]
        return bool(sets) and len(self._seen.joined) >= len(sets[-1].entries) + 2
