"""A simulated site: machines, the processes on them, and robots that drive."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.ingest import node as ingest
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.mapbuilder import node as mapbuilder
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.projector import node as projector
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.options import ProjectorOptions
from eigenscan.recorder import node as recorder
from eigenscan.recorder.options import RecorderOptions
from eigenscan.runtime.node import Service
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.tick import TICK
from eigenscan.schemas.wire import encode, encoding
from eigenscan.tracker import node as tracker
from eigenscan.tracker.options import TrackerOptions
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock
from eigenscan.workbench.simtest.disk import Disk
from eigenscan.workbench.simtest.hall import hall
from eigenscan.workbench.simtest.network import Network
from eigenscan.workbench.simtest.process import Process
from eigenscan.workbench.simtest.robot import Robot, SyntheticProjector
from eigenscan.workbench.simtest.session import Bytes, Sample, Session

if TYPE_CHECKING:
    from eigenscan.workbench.simtest.faults import Fault

SITE = "site"
"""Its name, and that of its one machine that is no robot."""


REAL_RATE = 4
"""Factor on the rates with the real projector: one scan must see much of what the one before saw."""
LONG_EVERY = 50
"""One seed in so many is a long story; the others are short, so that many fit into an hour of computing."""
FILE_MB, BUDGET_MB = 0.03, 0.15
"""Of a robot's recorder."""


@cache
def room(edition: int) -> SiteModel:
    """The models of a small room, whose wall moves between two editions."""
    cells = np.full((24, 24 + 2 * edition), OCCUPIED, dtype=np.uint8)
    cells[1:-1, 1:-1] = FREE
    grid = GridMap(cells, 0.2, np.zeros(3))
    return build_site(grid, MapbuilderSettings(spacing=1.0).plan)


@dataclass(frozen=True)
class Plan:
    """What a seed makes of a site, beside its faults."""

    robots: int
    scan_hz: float
    odometry_hz: float
    faults_s: float
    """In which faults begin."""
    rotate_minutes: float = 60.0
    """Of the site's recorder."""
    ingest: bool = False
    """Whether lidars give raw scans, and scan-ingest runs."""
    recorders: bool = False
    """Whether each robot has one, with a budget."""
    real: bool = False
    """Whether the projector is the real one, and the robots drive in a hall."""
    first_s: float = 10.0
    """Before it, nothing goes wrong."""
    longest_s: float = 30.0
    """Of a fault."""
    is_short: bool = False
    """Whether the story ends as soon as all has worked again for a while."""

    @classmethod
    def of(cls, seed: int, robots: int | None = None, *, real: bool = False) -> Plan:
        """By the seed alone. The real projector needs the scans of scan-ingest."""
        random = Random(f"{seed} plan")
        drawn = random.choice((1, 1, 2, 2, 3, 5))
        scan_hz = random.choice((0.5, 1.0, 2.0))
        plan = cls(
            robots or drawn,
            scan_hz,
            scan_hz * random.choice((2, 5)),
            random.uniform(20.0, 90.0),
            random.choice((0.2, 60.0)),
            random.random() < 0.3,
            random.random() < 0.3,
        )
        if seed % LONG_EVERY:
            fewer, faults_s = robots or (drawn + 1) // 2, plan.faults_s / 10.0
            plan = replace(plan, robots=fewer, faults_s=faults_s, first_s=4.0, longest_s=5.0, is_short=True)
        if not real:
            return plan
        scan_hz, odometry_hz = REAL_RATE * plan.scan_hz, REAL_RATE * plan.odometry_hz
        return replace(
            plan, real=True, ingest=True, recorders=False, scan_hz=scan_hz, odometry_hz=odometry_hz
        )


@dataclass
class Life:
    """What a process's core was given from its start to its end."""

    started: float
    handled: list[tuple[float, Channel, str, int]] = field(default_factory=list)
    """When, and the key and hash of each message that the recorder's core was given."""
    counters: dict[str, int] = field(default_factory=dict)
    """Of its core, at its end."""
    ended: float | None = None
    how: str = ""


class Observer:
    """A core, with a note of what it was given."""

    def __init__(self, core: Core, agenda: Agenda, on_condition: Callable[[], None], keeps: bool) -> None:
        self._core, self._agenda, self._on_condition, self._keeps = core, agenda, on_condition, keeps
        self.inputs, self.outputs = core.inputs, core.outputs
        self.life = Life(agenda.now)
        self.latched: dict[str, bytes] = {}
        """The newest of each latched key that the core was given."""

    def start(self) -> Iterable[Envelope]:
        """As the core."""
        return self._core.start()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """As the core."""
        if received.channel.qos.latched:
            self.latched[received.key] = received.payload or encode(received.message)
        if self._keeps and received.channel is not TICK:
            payload = received.payload or encode(received.message)
            self.life.handled.append((self._agenda.now, received.channel, received.key, hash(payload)))
        return self._core.handle(received)

    def finish(self) -> Iterable[Envelope]:
        """As the core."""
        return self._core.finish()

    def condition(self) -> Condition:
        """As the core."""
        self._on_condition()
        return self._core.condition()

    def close(self, how: str) -> None:
        """Its process ends."""
        self.life.ended, self.life.how = self._agenda.now, how
        self.life.counters = dict(self._core.condition().counters)


class Machine:
    """A clock, processes, and a robot's sensors, if it is one."""

    def __init__(self, site: Site, name: str, robot: Robot | None) -> None:
        self._site, self.name, self.robot = site, name, robot
        self.clock = MachineClock(site.agenda)
        self.processes: list[Process] = []
        self.is_on = False
        self.lost_power: list[float] = []
        """When."""
        self._driver: Session | None = None
        self._boots = 0

    def power_on(self, random: Random) -> None:
        """Starts what runs on it, in any order."""
        self.is_on = True
        self._boots += 1
        for process in self.processes:
            process.is_wanted = True
            self._site.agenda.after(random.uniform(0.0, 3.0), process.start)
        if self.robot is not None:
            self._driver = self._site.network.open(self.name, self.clock)
            plan = self._site.plan
            scan = self.robot.raw_scan if plan.ingest else self.robot.scan
            for hertz, make in ((plan.scan_hz, scan), (plan.odometry_hz, self.robot.odometry)):
                self._drive(1.0 / hertz, make, random.random() / hertz, self._boots)

    def power_off(self, random: Random) -> None:
        """At once; disks lose what was not synced."""
        self.is_on = False
        self.lost_power.append(self._site.agenda.now)
        for process in self.processes:
            process.is_wanted = False
            if process.is_up:
                process.end("power lost")
            process.disk.lose_power(random)
        if self._driver is not None:
            self._site.network.close(self._driver)
            self._driver = None

    def _drive(self, period: float, make: Callable[[float, int], Envelope], first: float, boot: int) -> None:
        def publish() -> None:
            if not self.is_on or self._boots != boot or self._driver is None:
                return
            one = make(self._site.agenda.now, self.clock.time_ns())
            self._site.publish(self._driver, one)
            self._site.agenda.after(period, publish)

        self._site.agenda.after(first, publish)


class Site:
    """All of it."""

    def __init__(self, seed: int, plan: Plan) -> None:
        self.seed, self.plan = seed, plan
        self.agenda = Agenda()
        self.network = Network(self.agenda, str(seed))
        self.random = Random(f"{seed} site")
        self.observers: dict[Process, Observer] = {}
        self.lives: dict[Process, list[Life]] = {}
        self.on_condition: Callable[[Process], None] = lambda _process: None
        self.notes: list[tuple[float, str]] = []
        self.edition = 0
        """Of the map."""
        self.going: defaultdict[tuple[str, object], list[Fault]] = defaultdict(list)
        """Faults that go on, by kind and by what they befall, in the order in which they began."""
        names = [f"r{number + 1}" for number in range(plan.robots)]
        self.robots = {name: Robot(SITE, name, str(seed), in_hall=plan.real) for name in names}
        self.machines = {SITE: Machine(self, SITE, None)}
        self.machines |= {name: Machine(self, name, self.robots[name]) for name in names}
        self._add(SITE, recorder.SERVICE, recorder.make_core, self._recorder_settings, keeps=True)
        self._add(SITE, mapbuilder.SERVICE, self._make_mapbuilder, self._mapbuilder_settings)
        for name in names:
            if plan.ingest:
                options = partial(self._ingest_settings, name)
                self._add(name, ingest.SERVICE, lambda given, _clock: ScanIngestCore(given), options)
            if plan.recorders:
                own = partial(self._robot_recorder_settings, name)
                self._add(name, recorder.SERVICE, recorder.make_core, own, keeps=True)
            self._add(name, tracker.SERVICE, tracker.make_core, partial(self._tracker_settings, name))
            if plan.real:
                real = replace(projector.SERVICE, make_port=None)
                keeping = partial(self._projector_settings, name)
                self._add(name, real, lambda given, _clock: ProjectorCore(given, given.instance), keeping)
                continue
            synthetic = Service("projector", ServiceSettings, lambda _settings: None)  # type: ignore[arg-type,return-value]
            self._add(
                name,
                synthetic,
                lambda settings, _clock: SyntheticProjector(self.robots, settings),
                partial(self._plain_settings, name),
            )
        self.network.arrived = _wake
        self.processes = [process for machine in self.machines.values() for process in machine.processes]
        """Of all machines."""

    def begin(self) -> None:
        """Switches everything on."""
        for name, machine in self.machines.items():
            machine.power_on(Random(f"{self.seed} boot {name}"))

    def publish(self, session: Session, one: Envelope) -> None:
        """Publishes for a driver."""
        sample = Sample(one.key, Bytes(encode(one.message)), encoding(one.channel))
        self.network.publish(session, sample, block=False)

    def _recorder_settings(self, disk: Disk) -> ServiceSettings:
        settings = RecorderOptions(
            site=SITE, mcap=Path("/recordings"), rotate_minutes=self.plan.rotate_minutes
        )
        return settings.model_copy(update={"mcap": disk.path("/recordings")})

    def _robot_recorder_settings(self, name: str, disk: Disk) -> ServiceSettings:
        settings = RecorderOptions(
            site=SITE,
            robot=name,
            instance=name,
            mcap=Path("/recordings"),
            rotate_mb=FILE_MB,
            budget_mb=BUDGET_MB,
        )
        return settings.model_copy(update={"mcap": disk.path("/recordings")})

    def _mapbuilder_settings(self, _disk: Disk) -> ServiceSettings:
        return MapbuilderOptions(site=SITE, map=Path("room.yaml"))

    def _make_mapbuilder(self, settings: MapbuilderOptions, _clock: MachineClock) -> Core:
        models = hall(self.edition % 2) if self.plan.real else room(self.edition % 2)
        return MapbuilderCore(settings, models, SITE)

    def _plain_settings(self, name: str, _disk: Disk) -> ServiceSettings:
        return ServiceSettings(site=SITE, robot=name, instance=name)

    def _projector_settings(self, name: str, disk: Disk) -> ServiceSettings:
        settings = ProjectorOptions(site=SITE, robot=name, instance=name)
        return settings.model_copy(update={"keep": disk.path("/keep")})

    def _ingest_settings(self, name: str, _disk: Disk) -> ServiceSettings:
        return ScanIngestOptions(site=SITE, robot=name, instance=name)

    def _tracker_settings(self, name: str, disk: Disk) -> ServiceSettings:
        settings = TrackerOptions(site=SITE, robot=name, instance=name)
        return settings.model_copy(update={"last_pose": disk.path("/poses"), "keep": disk.path("/keep")})

    def _add(
        self,
        machine: str,
        service: Service[Any],
        make_core: Callable[[Any, MachineClock], Core],
        settings: Callable[[Disk], ServiceSettings],
        *,
        keeps: bool = False,
    ) -> None:
        own = self.machines[machine]

        def observed(_disk: Disk) -> Service[Any]:
            def make(given: Any) -> Core:
                core = make_core(given, own.clock)
                observer = Observer(core, self.agenda, lambda: self.on_condition(process), keeps)
                self.observers[process] = observer
                self.lives.setdefault(process, []).append(observer.life)
                self.note(f"{process.name}: starts")
                return observer

            return replace(service, make_core=make, attend=None)

        process = Process(self.agenda, self.network, machine, own.clock, observed, settings)
        process.on_end = self._end
        own.processes.append(process)

    def note(self, text: str) -> None:
        """Something that a story may show."""
        self.notes.append((self.agenda.now, text))

    def _end(self, process: Process, how: str) -> None:
        self.note(f"{process.name}: {how}")
        observer = self.observers.get(process)
        if observer is not None and observer.life.ended is None:
            observer.close(how)


def _wake(session: Session, is_patient: bool) -> None:
    if session.owner is not None:
        session.owner.wake(is_patient)
