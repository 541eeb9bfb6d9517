"""A scripted hour: what goes wrong on a site in a year, one after the other, and what it cost each robot."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from eigenscan.cli.fleet.status import rows
from eigenscan.fleet.view import FleetView
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.health_pb2 import Health

from tests.machines.air import Link
from tests.machines.bad_air import (
    AIR_PERIOD_S,
    await_version,
    longest_gap,
    measure,
    renew_models,
    wrong_claims,
)
from tests.machines.site import KILL, PATIENCE_S, SERVICES, SITE, TERM, Fleet, Received, fleet

UNDER_WAY_S = 0.5
"""From a robot to the site."""
LOOK_EVERY_S = 0.3
DISK_MB = 24
CLOCK_S = -60.0
BAD_LINK = Link(loss=0.1, delay_s=0.1, jitter_s=0.03)
STEPS = (0.9, 1.0)
"""m, of the models that the site makes while it is cut off: never those that it has."""
OLD_LINKS_S = 25.0
"""Until the old links are gone: Zenoh's lease and what it gives a face to close, 10 s each."""
SETTLE_S = 4.0
"""Until every service has published its health several times."""


@dataclass
class Event:
    """One thing that went wrong. Times are s, since the beginning of the hour."""

    name: str
    touches: tuple[str, ...] = ()
    """Robots that miss something of their own meanwhile."""
    loses: tuple[str, ...] = ()
    """Robots whose words need not be in the site's recording meanwhile."""
    at_s: float = 0.0
    away_s: float = 0.0
    """Until what was taken works again, by its own word."""
    until_s: float = 0.0
    """Until all robots are localized, and received and recorded at the site."""
    unlocalized_s: dict[str, float] = field(default_factory=dict)
    """Longest time without a claim, of each robot, by the stamps of its scans."""
    unrecorded: int = 0
    """Poses published on the robots meanwhile that are not in the site's recording."""

    def beyond_s(self, robot: str) -> float:
        """Of that, what is not explained by what was taken being away."""
        return max(0.0, self.unlocalized_s[robot] - (self.away_s if robot in self.touches else 0.0))


@dataclass
class Hour:
    """A fleet at work, and what happened to it so far."""

    fleet: Fleet
    view: FleetView
    pause_s: float
    began: float = field(default_factory=time.monotonic)
    events: list[Event] = field(default_factory=list)
    whole: list[dict[str, Any]] = field(default_factory=list)
    """What `eigenscan fleet status` showed while all was well."""
    cut: list[dict[str, Any]] = field(default_factory=list)
    """And at the site just before robots could reach it again."""
    cut_s: float = 0.0
    """For how long it had been cut off then."""
    disk: dict[str, Any] = field(default_factory=dict)
    bad_air: dict[str, Any] = field(default_factory=dict)
    new_models_s: dict[str, float] = field(default_factory=dict)
    """From the end of the cut until each robot worked with the models that were made meanwhile."""

    @contextmanager
    def event(self, name: str, touches: Sequence[str] = (), loses: Sequence[str] = ()) -> Iterator[Event]:
        """Notes an event; at its end all is as it was before. What was received until then is on the disk."""
        event = Event(name, tuple(touches), tuple(loses))
        begin = time.monotonic()
        event.at_s = begin - self.began
        if loses:
            self._await_recorded(begin)
        began = time.monotonic()
        yield event
        back = time.monotonic()
        event.away_s = back - began
        self.fleet.await_claims(self.fleet.robots, back)
        self.fleet.await_claims(self.fleet.robots, back, at_site=True)
        if loses:
            self._await_any_recorded(back)
        event.until_s = time.monotonic() - self.began
        self.events.append(event)
        time.sleep(self.pause_s)

    def _await_recorded(self, before: float) -> None:
        """Waits until all that the site had received before that moment is on the disk."""

        def missing() -> set[tuple[str, int]]:
            received = self._arrived().items()
            due = {key for key, at in received if self.began < at < before and not self._is_lost(at)}
            return due - self._recorded()

        self._until_none(missing, "heard, but not recorded")

    def _await_any_recorded(self, since: float) -> None:
        """Waits until something that the site received from each robot since then is on the disk."""

        def missing() -> set[str]:
            fresh = {key for key, at in self._arrived().items() if at > since} & self._recorded()
            return set(self.fleet.robots) - {robot for robot, _ in fresh}

        self._until_none(missing, "not recorded again")

    def _recorded(self) -> set[tuple[str, int]]:
        return recorded_poses(self.fleet.recordings)

    def _until_none(self, missing: Callable[[], Collection[object]], about: str) -> None:
        limit = time.monotonic() + PATIENCE_S
        while found := missing():
            assert time.monotonic() < limit, f"{about}: {found}\n{self.fleet.site.log('recorder')}"
            time.sleep(LOOK_EVERY_S)

    def restart(self, name: str, service: str, how: int) -> None:
        """Ends a service of a machine and starts it at once, as whatever keeps it up would."""
        machine = self.fleet.machines[name]
        touches = (name,) if machine.kind == "robot" else ()
        loses: Sequence[str] = ()
        if service in ("router", "recorder"):
            # a robot's router is there before its link to the site is
            loses = self.fleet.robots if name == "site" else [name]
        word = "killed" if how == KILL else "restarted"
        with self.event(f"{name}: {service} {word}", touches, loses):
            machine.end(service, how)
            since = time.monotonic()
            machine.start(service)
            machine.await_word(service, since)

    def roll(self, names: Sequence[str], how: int) -> None:
        """Every service of these machines, one at a time."""
        for name in names:
            for service in SERVICES[self.fleet.machines[name].kind]:
                self.restart(name, service, how)

    def spoil_a_link(self, link: Link, seconds: float) -> None:
        """The last robot's radio is bad for a while."""
        name = f"{link.loss:.0%} lost, {2e3 * link.delay_s:.0f} ms there and back"
        with self.event(name, loses=self.fleet.robots):
            self.bad_air = measure(self.fleet, self.fleet.robots[-1], link, seconds)

    def cut_off_the_site(self, seconds: float, step: float) -> None:
        """Nobody reaches the site, which makes new models; then all do."""
        link = self.fleet.air.links["site"]
        with self.event(f"site cut off for {seconds:.0f} s", loses=self.fleet.robots):
            link.cut = True
            began = time.monotonic()
            version = renew_models(self.fleet, step)
            time.sleep(max(0.0, seconds - (time.monotonic() - began)))
            self.cut_s = time.monotonic() - began
            self.cut = rows(self.view)
            link.cut = False
        self.new_models_s = {
            robot: await_version(self.fleet, robot, version) - began - self.cut_s
            for robot in self.fleet.robots
        }

    def settle_links(self) -> None:
        """Old links go when new ones are there; a router whose link stays dead ends and restarts."""
        with self.event("links settle", touches=self.fleet.robots, loses=self.fleet.robots):
            time.sleep(OLD_LINKS_S)

    def fill_the_disk(self, seconds: float) -> None:
        """Somebody else's files take all that the recorder's disk has; then they are gone."""
        site, ballast = self.fleet.site, self.fleet.recordings / "ballast"
        with self.event(f"recorder's disk full for {seconds:.0f} s", loses=self.fleet.robots):
            with suppress(OSError), ballast.open("wb", buffering=0) as file:
                while file.write(b"x" * 65536):
                    pass
            self._await_recorder(Health.STATUS_DEGRADED)
            time.sleep(seconds)
            _, published = site.ear.health["recorder", "site"]
            self.disk = {"detail": published.detail, "counters": dict(published.counters)}
            ballast.unlink()
            self._await_recorder(Health.STATUS_OK)
        self.disk["files"] = {path.name: path.stat().st_size for path in self.fleet.recordings.glob("*.mcap")}

    def _await_recorder(self, status: int) -> None:
        ear = self.fleet.site.ear
        ear.wait_for(
            lambda: ear.health["recorder", "site"][1].status == status,
            f"the recorder to be {Health.Status.Name(status)}\n{self.fleet.site.log('recorder')}",
        )

    def result(self) -> dict[str, Any]:
        """What it cost; ends the recorder, so that its last file is whole."""
        ended = time.monotonic()
        self._await_recorded(ended)
        self.fleet.site.end("recorder", TERM)
        recorded = recorded_poses(self.fleet.recordings)
        arrived = self._arrived()
        for event in self.events:
            begin, end = event.at_s + self.began, event.until_s + self.began
            event.unlocalized_s = {
                robot: longest_gap(self.fleet, robot, begin, end) for robot in self.fleet.robots
            }
            event.unrecorded = sum(
                self._is_within(received, event) and key not in recorded
                for key, received in self._published()
            )
        published = [
            key
            for key, received in self._published()
            if received.at < ended - UNDER_WAY_S and not self._is_excused(key[0], received)
        ]
        received_at_site = [
            key for key, at in arrived.items() if self.began < at < ended and not self._is_lost(at)
        ]
        return {
            "robots": len(self.fleet.robots),
            "seconds": time.monotonic() - self.began,
            "load": os.getloadavg()[0],
            "claims": sum(len(self._claims(robot)) for robot in self.fleet.robots),
            "wrong": {robot: wrong_claims(self.fleet, robot) for robot in self.fleet.robots},
            # outside the events that may lose some
            "said": len(published),
            "undelivered": sum(key not in arrived for key in published),
            "longest_undelivered": max(
                _longest_row([key not in arrived for key in published if key[0] == robot])
                for robot in self.fleet.robots
            ),
            "heard_at_site": len(received_at_site),
            "unrecorded": sum(key not in recorded for key in received_at_site),
            "events": [
                asdict(event) | {"beyond_s": {robot: event.beyond_s(robot) for robot in event.unlocalized_s}}
                for event in self.events
            ],
            "disk": self.disk,
            "bad_air": self.bad_air,
            "new_models_s": self.new_models_s,
            "status": {"whole": self.whole, "cut": self.cut, "cut_s": self.cut_s},
        }

    def _poses(self, robot: str) -> list[Received]:
        return self.fleet.machines[robot].ear.poses[robot]

    def _claims(self, robot: str) -> list[Received]:
        return [received for received in self._poses(robot) if received.is_claim]

    def _published(self) -> Iterator[tuple[tuple[str, int], Received]]:
        """Poses that the robots published, but those that the air's limit may hold back."""
        for robot in self.fleet.robots:
            for before, received in pairwise(self._poses(robot)):
                if received.at > self.began and received.at - before.at > AIR_PERIOD_S:
                    yield (robot, received.stamp), received

    def _arrived(self) -> dict[tuple[str, int], float]:
        """When the site received the pose of which robot and stamp, monotonic, s."""
        ear = self.fleet.site.ear
        return {
            (robot, one.stamp): one.at
            for robot, published in list(ear.poses.items())
            for one in list(published)
        }

    def _is_within(self, received: Received, event: Event) -> bool:
        return event.at_s - UNDER_WAY_S < received.at - self.began < event.until_s

    def _is_excused(self, robot: str, received: Received) -> bool:
        return any(robot in event.loses and self._is_within(received, event) for event in self.events)

    def _is_lost(self, at: float) -> bool:
        """Whether the recorder or its way to the site's router, was down when the site received."""
        everybody = set(self.fleet.robots)
        return any(
            set(event.loses) == everybody and event.at_s <= at - self.began < event.until_s
            for event in self.events
        )


def _longest_row(holds: Iterable[bool]) -> int:
    longest = row = 0
    for one in holds:
        row = row + 1 if one else 0
        longest = max(longest, row)
    return longest


def recorded_poses(folder: Path) -> set[tuple[str, int]]:
    """Robot and stamp of each pose in the recordings of `folder`."""
    found = set()
    for path in sorted(folder.glob("*.mcap")):
        for record in read(path):
            if record.envelope.channel is POSE:
                found.add((record.envelope.address["robot"], record.envelope.stamp))
    return found


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A disk of DISK_MB, in memory."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "eigenscan", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


@contextmanager
def hour(
    folder: Path, robots: Sequence[str], seconds: float, pause_s: float, hold_back_floods: bool = True
) -> Iterator[Hour]:
    """A fleet whose first robot's clock is a minute behind, ready for an hour of `seconds` at most.

    Without `hold_back_floods` the site's router lets through what comes late and at once: all of it counts.
    """
    with (
        small_disk(folder / "recordings") as disk,
        fleet(folder, robots, seconds, {robots[0]: CLOCK_S}, disk, hold_back_floods) as made,
        FleetView(made.site.session(), SITE) as view,
        _updating(view),
    ):
        time.sleep(SETTLE_S)
        yield Hour(made, view, pause_s)


@contextmanager
def _updating(view: FleetView) -> Iterator[None]:
    """Ages count from when a message is taken in."""
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.1):
            view.update()

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield
    over.set()
    thread.join()


def play(
    hour: Hour, cut_s: float, full_s: float, rounds: int, report: Callable[[str], None]
) -> dict[str, Any]:
    """The script, `rounds` times. Of one round only, half of the robots are restarted, the others killed."""
    robots = hour.fleet.robots
    hour.whole = rows(hour.view)
    for number in range(rounds):
        report(f"round {number + 1} of {rounds}")
        restarted = robots if rounds > 1 else robots[: len(robots) // 2]
        killed = robots if rounds > 1 else robots[len(robots) // 2 :]
        hour.roll([*restarted, "site"], TERM)
        hour.fill_the_disk(full_s)
        hour.spoil_a_link(BAD_LINK, full_s)
        hour.cut_off_the_site(cut_s, STEPS[number % 2])
        hour.settle_links()
        hour.roll([*killed, "site"], KILL)
    return hour.result()
