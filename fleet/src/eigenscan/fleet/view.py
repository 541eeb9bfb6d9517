"""The state of a site: the newest messages of its robots and services, and their ages."""

from __future__ import annotations

import json
import time
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.certificates import fault_in
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.health import has_fallen
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.session import MEETING, UnreachableError, open_meanwhile
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.advice_words import HOLDS_S, words_of
from eigenscan.schemas.channels import (
    ADVICE,
    ALIVE_TEMPLATE,
    CHANNELS,
    HEALTH,
    MODEL_SET,
    POSE,
    ContractError,
)
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.group import EVERY, holds, is_one, patterns
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, PoseEstimate
from eigenscan.schemas.wire import decode
from eigenscan.schemas.words import UNKNOWN, status_word

OPEN_S = 5.0
"""A client's configuration may wait for its router without end; a person does not."""

ROBOT_SERVICES = ("scan-ingest", "projector", "tracker")
"""Services that each robot needs, its own or one for several robots."""

FORGOTTEN_S = 24 * 3600.0
"""A robot or service that is gone and silent for this long, s, is no longer shown."""

MOST_SETTINGS = 20_000
"""Longest settings of a service, in characters: ten times our longest."""

TWICE_S = 6.0
"""Two falls of a service's counters within this time, s, are none of a restart, which takes longer."""

OFFSETS = 10
"""Words by which a clock is judged: on a busy machine or link some are late."""


class NoRouterError(FailedError):
    """No session within OPEN_S, or at once where the configuration does not wait."""


def connect(path: Path | None) -> zenoh.Session:
    """Session from a Zenoh configuration. Raises NoRouterError, or ContractError naming the file."""
    try:
        return open_meanwhile(path, "peer").result(OPEN_S)
    except (TimeoutError, UnreachableError) as error:
        if fault := fault_in(path):
            raise NoRouterError(f"no router takes this certificate: {fault}") from error
        what = (
            f"start the router, or correct connect.endpoints in {path}; a "
            "router of another fleet does not answer"
            if path
            else f"{MEETING} is in use by another program: end it, or give --zenoh FILE with another address"
        )
        within = f" within {OPEN_S:.0f} s" if isinstance(error, TimeoutError) else ""
        raise NoRouterError(f"nobody answers{within}: {what}") from error


@lru_cache(maxsize=1024)
def settings_in(text: str) -> Mapping[str, str]:
    """The settings in a service's health, as text; none if `text` is not a JSON object of a fair size.

    Anyone who may publish health may write anything here.
    """
    try:
        values = json.loads(text) if len(text) <= MOST_SETTINGS else None
        if not isinstance(values, dict):
            return {}
        found = {str(name): str(value) for name, value in values.items()}
        patterns(found.get("robot", EVERY))
    except (ValueError, RecursionError):
        return {}
    return found


def _is_sound(pose: PoseEstimate) -> bool:
    """Whether a pose is one that can be shown: finite, in a world of a fair size, its confidence a share."""
    places = pose.pose, pose.floor_pose
    return 0 <= pose.confidence <= 1 and all(
        abs(value) <= FARTHEST_M for at in places for value in (at.x, at.y, at.theta)
    )


@dataclass
class Service:
    """One instance of a service; times are monotonic, s."""

    name: str
    instance: str
    contracts: set[str] = field(default_factory=set)
    """Versions of the contract in its liveliness tokens; empty: it is not there (any more)."""
    health: Health | None = None
    first: Health | None = None
    received_at: float = 0.0
    falls: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    """When a counter was last below its value before: a restart, or another process under the same name."""
    offsets: deque[float] = field(default_factory=lambda: deque(maxlen=OFFSETS))
    """How far the stamps of its latest words were before our clock, s."""

    @property
    def clock_offset_s(self) -> float | None:
        """How far its clock is before ours, by the word that was quickest on its way."""
        return min(self.offsets, key=abs, default=None)

    def receive(self, health: Health, now: float) -> None:
        """Takes its next health, at `now`, monotonic s."""
        if self.health is not None and has_fallen(self.health.counters, health.counters):
            self.falls.append(now)
            self.first = Health()  # it counts from 0 again
        self.first = self.first or health
        self.health, self.received_at = health, now

    @property
    def is_twice(self) -> bool:
        """Whether its counters fall again and again: two processes publish under its name."""
        return len(self.falls) == 2 and time.monotonic() - self.falls[0] < TWICE_S

    @property
    def robot(self) -> str:
        """The robots that it serves, as a group; its instance, if its health does not name them."""
        return self.setting("robot", self.instance)

    def setting(self, name: str, otherwise: str) -> str:
        """The value of one of its settings."""
        text = self.health.settings if self.health is not None else ""
        return settings_in(text).get(name, otherwise)

    @property
    def status(self) -> str:
        """`ok`, `waiting`, `degraded`, or `unknown` before its first health."""
        return UNKNOWN if self.health is None else status_word(self.health.status)

    def counter(self, name: str) -> int:
        """Value of one of its counters; 0 if there is none."""
        return int(self.health.counters.get(name, 0)) if self.health is not None else 0

    def grew(self, name: str) -> int:
        """Growth of a counter since this service's first health."""
        return self.counter(name) - (int(self.first.counters.get(name, 0)) if self.first is not None else 0)

    @property
    def drops(self) -> dict[str, int]:
        """Samples that its full inbox dropped, by channel."""
        counters = self.health.counters if self.health is not None else {}
        return {name.removeprefix("dropped_"): int(n) for name, n in counters.items() if name in _DROPS and n}


_DROPS = frozenset(f"dropped_{channel.name}" for channel in CHANNELS)


@dataclass
class Robot:
    """The newest pose of one robot, and the newest advice to it."""

    name: str
    pose: PoseEstimate | None = None
    received_at: float = 0.0
    advice: Advice | None = None
    advised_at: float = 0.0

    def is_old(self, newest: str) -> bool:
        """Whether its pose is by other models than the site's newest, as far as both are stated."""
        own = self.pose.model_version if self.pose is not None else ""
        return bool(own and newest) and own != newest

    @property
    def advised(self) -> str:
        """The advice in words, while it holds: the pose is ambiguous, and it came just now."""
        holds = self.pose is not None and self.pose.state == STATE_AMBIGUOUS
        if self.advice is None or not holds or time.monotonic() - self.advised_at > HOLDS_S:
            return ""
        return words_of(self.advice)


class FleetView:
    """Listens to a site; `update` takes the messages since the last call.

    `listed`: all robots of its fleet, if known. `expected`: further ones that belong to it. Both may be away.
    """

    def __init__(
        self, session: zenoh.Session, site: str, listed: Collection[str] = (), expected: Collection[str] = ()
    ) -> None:
        self.site, self.listed = site, frozenset(listed)
        self.expected = self.listed | frozenset(expected)
        self.robots: dict[str, Robot] = {}
        self.services: dict[tuple[str, str], Service] = {}
        self.map_version = ""
        self.model_versions = deque[str](maxlen=2)
        """Of the latest two model sets."""
        self._inbox = Inbox()
        self._tokens: list[tuple[str, bool]] = []
        self._bus = Bus(session)
        everyone = ALIVE_TEMPLATE.format(site=site, service="*", instance="*", contract="*")
        try:
            self._bus.listen([HEALTH, POSE, ADVICE, MODEL_SET], {"site": site}, self._inbox)
            self._watch = session.liveliness().declare_subscriber(everyone, self._on_token, history=True)
        except Exception:
            self._bus.close()  # a session that is left open keeps the process
            raise

    def __enter__(self) -> FleetView:
        return self

    def __exit__(self, *_: object) -> None:
        self._watch.undeclare()
        self._bus.close()

    def _on_token(self, sample: Any) -> None:
        self._tokens.append((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

    @property
    def model_version(self) -> str:
        """Version of the latest model set; empty: none has come."""
        return self.model_versions[-1] if self.model_versions else ""

    def publish(self, envelope: Envelope) -> None:
        """Publishes something to the site."""
        self._bus.publish(envelope)

    def update(self, of: str | None = None) -> list[PoseEstimate]:
        """Takes the messages since the last call; ages count from now.

        Returns their poses, those of one robot or of every one.
        """
        poses = list[PoseEstimate]()
        while self._tokens:
            key, there = self._tokens.pop(0)
            _, _, name, instance, contract = key.split("/")
            contracts = self._service(name, instance).contracts
            (contracts.add if there else contracts.discard)(contract)
        while (arrival := self._inbox.take(0.0)) is not None:
            for robot, pose in self._receive(arrival, time.monotonic(), time.time_ns()):
                if of in (None, robot):
                    poses.append(pose)
        since = time.monotonic() - FORGOTTEN_S
        self.robots = {name: each for name, each in self.robots.items() if each.received_at > since}
        self.services = {
            who: each for who, each in self.services.items() if each.contracts or each.received_at > since
        }
        return poses

    def until(self, holds: Callable[[], bool], seconds: float) -> bool:
        """Takes messages until `holds` is true; False if it is not within `seconds`."""
        end = time.monotonic() + seconds
        while not holds():
            if (left := end - time.monotonic()) <= 0:
                return False
            time.sleep(min(left, 0.05))
            self.update()
        return True

    def _receive(self, arrival: Arrival, now: float, wall: int) -> list[tuple[str, PoseEstimate]]:
        try:
            message = decode(arrival.channel, arrival.payload, arrival.encoding)
        except ContractError:
            return []  # not of this contract, and not ours to judge
        address = arrival.channel.parse(arrival.key) or {}
        if isinstance(message, ModelSet):
            self.map_version = message.map_version
            self.model_versions.append(message.version)
        elif isinstance(message, PoseEstimate):
            if not _is_sound(message):
                return []  # anyone may publish one; no tracker of ours does
            robot = self.robots.setdefault(address["robot"], Robot(address["robot"]))
            robot.pose, robot.received_at = message, now
            return [(robot.name, message)]
        elif isinstance(message, Advice):
            robot = self.robots.setdefault(address["robot"], Robot(address["robot"], received_at=now))
            robot.advice, robot.advised_at = message, now
        elif isinstance(message, Health):
            service = self._service(address["service"], address["instance"])
            service.offsets.append((nanoseconds(message.timestamp) - wall) * 1e-9)
            service.receive(message, now)
        return []

    def _service(self, name: str, instance: str) -> Service:
        return self.services.setdefault((name, instance), Service(name, instance))

    @property
    def is_silent(self) -> bool:
        """Whether nothing of the site was received: no service is there, and no robot."""
        return not self.robots and not any(each.contracts for each in self.services.values())

    def robot_names(self) -> list[str]:
        """Every robot that was received, or that a service is there for."""
        served = {
            name
            for each in self.services.values()
            if each.name in ROBOT_SERVICES
            for name in patterns(each.robot)
            if is_one(name)
        }
        return sorted(served | set(self.robots))

    def all_robots(self) -> list[str]:
        """These, and those that belong to the site and are not there."""
        return sorted({*self.robot_names(), *self.expected})

    def is_stranger(self, robot: str) -> bool:
        """Whether a robot is not of the fleet: its certificate is revoked, or newer than our list."""
        return bool(self.listed) and robot not in self.expected

    def health(self, name: str, instance: str | None = None) -> Health | None:
        """The newest word of a service of that name on itself; of one instance of it, if that is named."""
        text = [
            each
            for each in self.services.values()
            if each.name == name and instance in (None, each.instance) and each.health is not None
        ]
        return max(text, key=lambda each: each.received_at).health if text else None

    def serving(self, robot: str, names: Collection[str] = ROBOT_SERVICES) -> Iterator[Service]:
        """The services of these names that work for one robot, its own and those for all."""
        for service in self.services.values():
            if service.name in names and holds(service.robot, robot):
                yield service


def no_service(site: str) -> str:
    """What is wrong, and the fix, where no service of a site answers."""
    return f"no service of site {site} answers: check --site, or start its services"
