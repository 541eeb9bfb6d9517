"""A scripted hour: what goes wrong on a site in a year, one after the other, and what it cost each robot."""

import os
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from eigenscan.cli.fleet.status import rows
from eigenscan.cli.fleet.view import FleetView
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate

from tests.machines.air import Link
from tests.machines.bad_air import (
    AIR_PERIOD_S,
    await_version,
    longest_gap,
    measure,
    renew_models,
    wrong_claims,
)
from tests.machines.site import KILL, SERVICES, SITE, TERM, Fleet, Heard, fleet

FLUSH_S = 0.5
"""The recorder's: so much of what came before may be lost with its disk, or when it is killed."""
UNDER_WAY_S = 0.5
"""From a robot to the site's file, on a busy machine."""
DISK_MB = 24
CLOCK_S = -60.0
BAD_LINK = Link(loss=0.1, delay_s=0.1, jitter_s=0.03)
STEPS = (0.9, 1.0)
"""m, of the models that the site makes while it is cut off: never those that it has."""
SETTLE_S = 4.0
"""Until every service has said several times how it is."""


@dataclass
class Event:
    """One thing that went wrong. Times are s, since the beginning of the hour."""

    name: str
    touches: tuple[str, ...] = ()
    """Robots that miss something of their own meanwhile."""
    loses: bool = False
    """Whether what the robots say meanwhile need not be in the site's recording."""
    at_s: float = 0.0
    away_s: float = 0.0
    """Until what was taken works again, by its own word."""
    until_s: float = 0.0
    """Until all robots are localized and heard at the site."""
    unlocalized_s: dict[str, float] = field(default_factory=dict)
    """Longest time without a claim, of each robot, by the stamps of its scans."""
    unrecorded: int = 0
    """Poses said on the robots meanwhile that are not in the site's recording."""

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
    disk: dict[str, Any] = field(default_factory=dict)
    bad_air: dict[str, Any] = field(default_factory=dict)
    new_models_s: dict[str, float] = field(default_factory=dict)
    """From the end of the cut until each robot worked with the models that were made meanwhile."""

    @contextmanager
    def event(self, name: str, touches: Sequence[str] = (), loses: bool = False) -> Iterator[Event]:
        """Notes an event; at its end all is as it was before."""
        event = Event(name, tuple(touches), loses)
        began = time.monotonic()
        event.at_s = began - self.began
        yield event
        back = time.monotonic()
        event.away_s = back - began
        self.fleet.await_claims(self.fleet.robots, back)
        self.fleet.await_claims(self.fleet.robots, back, at_site=True)
        event.until_s = time.monotonic() - self.began
        self.events.append(event)
        time.sleep(self.pause_s)

    def restart(self, name: str, service: str, how: int) -> None:
        """Ends a service of a machine and starts it at once, as whatever keeps it up would."""
        machine = self.fleet.machines[name]
        touches = (name,) if machine.kind == "robot" else ()
        loses = name == "site" and service != "mapbuilder"
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
        with self.event(name, loses=True):
            self.bad_air = measure(self.fleet, self.fleet.robots[-1], link, seconds)

    def cut_off_the_site(self, seconds: float, step: float) -> None:
        """Nobody reaches the site, which makes new models; then all do."""
        link = self.fleet.air.links["site"]
        with self.event(f"site cut off for {seconds:.0f} s", loses=True):
            link.cut = True
            began = time.monotonic()
            version = renew_models(self.fleet, step)
            time.sleep(max(0.0, seconds - (time.monotonic() - began)))
            self.cut = rows(self.view)
            link.cut = False
        self.new_models_s = {
            robot: await_version(self.fleet, robot, version) - began - seconds for robot in self.fleet.robots
        }

    def fill_the_disk(self, seconds: float) -> None:
        """Somebody else's files take all that the recorder's disk has; then they are gone."""
        site, ballast = self.fleet.site, self.fleet.recordings / "ballast"
        with self.event(f"recorder's disk full for {seconds:.0f} s", loses=True):
            with suppress(OSError), ballast.open("wb", buffering=0) as file:
                while file.write(b"x" * 65536):
                    pass
            self._await_recorder(Health.STATUS_DEGRADED)
            time.sleep(seconds)
            _, said = site.ear.health["recorder", "site"]
            self.disk = {"detail": said.detail, "counters": dict(said.counters)}
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
        time.sleep(UNDER_WAY_S)
        ended = time.monotonic()
        self.fleet.site.end("recorder", TERM)
        recorded = recorded_poses(self.fleet.recordings)
        arrived = {(robot, one.stamp) for robot, said in self.fleet.site.ear.poses.items() for one in said}
        for event in self.events:
            begin, end = event.at_s + self.began, event.until_s + self.began
            event.unlocalized_s = {
                robot: longest_gap(self.fleet, robot, begin, end) for robot in self.fleet.robots
            }
            event.unrecorded = sum(
                self._is_within(heard, event) and key not in recorded for key, heard in self._said()
            )
        said = [
            key
            for key, heard in self._said()
            if heard.at < ended - UNDER_WAY_S and not self._is_excused(heard)
        ]
        return {
            "robots": len(self.fleet.robots),
            "seconds": time.monotonic() - self.began,
            "load": os.getloadavg()[0],
            "claims": sum(len(self._claims(robot)) for robot in self.fleet.robots),
            "wrong": {robot: wrong_claims(self.fleet, robot) for robot in self.fleet.robots},
            # outside the events that may lose some
            "said": len(said),
            "unrecorded": sum(key in arrived and key not in recorded for key in said),
            "undelivered": sum(key not in arrived for key in said),
            "events": [
                asdict(event) | {"beyond_s": {robot: event.beyond_s(robot) for robot in event.unlocalized_s}}
                for event in self.events
            ],
            "disk": self.disk,
            "bad_air": self.bad_air,
            "new_models_s": self.new_models_s,
            "status": {"whole": self.whole, "cut": self.cut},
        }

    def _poses(self, robot: str) -> list[Heard]:
        return self.fleet.machines[robot].ear.poses[robot]

    def _claims(self, robot: str) -> list[Heard]:
        return [heard for heard in self._poses(robot) if heard.is_claim]

    def _said(self) -> Iterator[tuple[tuple[str, int], Heard]]:
        """Poses that the robots said, but those that the air's limit may hold back."""
        for robot in self.fleet.robots:
            for before, heard in pairwise(self._poses(robot)):
                if heard.at > self.began and heard.at - before.at > AIR_PERIOD_S:
                    yield (robot, heard.stamp), heard

    def _is_within(self, heard: Heard, event: Event) -> bool:
        begin = event.at_s + self.began - FLUSH_S - UNDER_WAY_S
        return begin < heard.at < event.until_s + self.began

    def _is_excused(self, heard: Heard) -> bool:
        return any(event.loses and self._is_within(heard, event) for event in self.events)


def recorded_poses(folder: Path) -> set[tuple[str, int]]:
    """Robot and stamp of each pose in the recordings of `folder`."""
    found = set()
    for path in sorted(folder.glob("*.mcap")):
        for record in read(path):
            if record.envelope.channel is POSE:
                pose = record.envelope.open(PoseEstimate)
                found.add((record.envelope.address["robot"], nanoseconds(pose.timestamp)))
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
def hour(folder: Path, robots: Sequence[str], seconds: float, pause_s: float) -> Iterator[Hour]:
    """A fleet whose first robot's clock is a minute behind, ready for an hour of `seconds` at most."""
    with (
        small_disk(folder / "recordings") as disk,
        fleet(folder, robots, seconds, {robots[0]: CLOCK_S}, disk) as made,
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


def play(hour: Hour, cut_s: float, full_s: float, rounds: int, tell: Callable[[str], None]) -> dict[str, Any]:
    """The script, `rounds` times. Of one round only, half of the robots are restarted, the others killed."""
    robots = hour.fleet.robots
    hour.whole = rows(hour.view)
    for number in range(rounds):
        tell(f"round {number + 1} of {rounds}")
        restarted = robots if rounds > 1 else robots[: len(robots) // 2]
        killed = robots if rounds > 1 else robots[len(robots) // 2 :]
        hour.roll([*restarted, "site"], TERM)
        hour.fill_the_disk(full_s)
        hour.spoil_a_link(BAD_LINK, full_s)
        hour.cut_off_the_site(cut_s, STEPS[number % 2])
        hour.roll([*killed, "site"], KILL)
    return hour.result()
