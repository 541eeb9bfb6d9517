"""What befalls a site: drawn from a seed, done to it, and reported in words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from random import Random

from eigenscan.workbench.simtest.network import Link
from eigenscan.workbench.simtest.process import HANDLING_S, Process
from eigenscan.workbench.simtest.robot import AS_DRIVEN
from eigenscan.workbench.simtest.session import Session
from eigenscan.workbench.simtest.site import SITE, Machine, Plan, Site
from eigenscan.workbench.simtest.stranger import FLOOD_S, PERIOD_S, Stranger

Undo = Callable[[], None]


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong."""

    at: float
    """s from the beginning."""
    kind: str
    place: str
    """A machine."""
    part: int
    """Which of its processes, or which other machine."""
    amount: float
    """0..1, how bad."""
    lasts: float
    """s; of some kinds, none."""

    @property
    def end(self) -> float:
        """S from the beginning."""
        return self.at + (self.lasts if KINDS[self.kind].lasts else 0.0)

    def begin(self, site: Site) -> None:
        """Does it, and undoes it in time; where others of its kind go on, the newest of them decides."""
        kind = KINDS[self.kind]
        undo = kind.do(site, self)
        if undo is None or kind.where is None:
            return
        going = site.going[self.kind, kind.where(site, self)]
        going.append(self)

        def end() -> None:
            going.remove(self)
            if going:
                kind.do(site, going[-1])
            else:
                undo()

        site.agenda.after(self.lasts, end)

    def words(self, site: Site) -> str:
        """What happens."""
        kind = KINDS[self.kind]
        text = kind.words(site, self)
        return f"{text}, for {self.lasts:.1f} s" if kind.lasts else text


@dataclass(frozen=True)
class Kind:
    """A kind of fault; doing it once more, where it is done, changes nothing but its amount."""

    do: Callable[[Site, Fault], Undo | None]
    words: Callable[[Site, Fault], str]
    where: Callable[[Site, Fault], object] | None = None
    """What it befalls until it is undone; None: it is over at once."""

    @property
    def lasts(self) -> bool:
        """Whether it is undone after a time."""
        return self.where is not None


def _process(site: Site, fault: Fault) -> Process:
    own = site.machines[fault.place].processes
    return own[fault.part % len(own)]


def _machine(site: Site, fault: Fault) -> Machine:
    return site.machines[fault.place]


def _link(site: Site, fault: Fault) -> tuple[Link, str]:
    """Between a robot and the site, or within a machine."""
    if fault.place == SITE or fault.part % 2:
        return site.network.link(fault.place, fault.place), f"within {fault.place}"
    return site.network.link(fault.place, SITE), f"between {fault.place} and the site"


def _set(attribute: str, value: Callable[[Fault], float]) -> Callable[[Site, Fault], Undo]:
    def do(site: Site, fault: Fault) -> Undo:
        link, _ = _link(site, fault)
        setattr(link, attribute, value(fault))
        return lambda: setattr(link, attribute, 0.0)

    return do


def _robot(_site: Site, fault: Fault) -> str:
    return fault.place if fault.place != SITE else "r1"


def _cut(site: Site, fault: Fault) -> Undo:
    link = site.network.link(_robot(site, fault), SITE)
    site.network.cut(link)
    return lambda: site.network.mend(link)


def _kill(site: Site, fault: Fault) -> None:
    process = _process(site, fault)
    if process.is_up:
        process.end("killed")


def _kill_in_write(site: Site, fault: Fault) -> None:
    _process(site, fault).disk.kill_at = int(20 * fault.amount)


def _stop(site: Site, fault: Fault) -> None:
    _process(site, fault).stop()


def _slow(site: Site, fault: Fault) -> Undo:
    process = _process(site, fault)
    process.handling_s = 0.02 + 0.5 * fault.amount

    def undo() -> None:
        process.handling_s = HANDLING_S

    return undo


def _silence(site: Site, fault: Fault) -> None:
    session: Session | None = _process(site, fault).session
    if session is not None:
        session.is_silent = True


def _off(site: Site, fault: Fault) -> Undo:
    machine, random = _machine(site, fault), Random(f"{site.seed} off {fault.at}")
    if machine.is_on:
        machine.power_off(random)
    return lambda: None if machine.is_on else machine.power_on(random)


def clock_step_s(fault: Fault) -> float:
    """Up to an hour, back or forwards; small ones as often as large ones."""
    size = float(0.05 * 72000.0 ** abs(2.0 * fault.amount - 1.0))
    return size if fault.amount > 0.5 else -size


def _clock(site: Site, fault: Fault) -> None:
    _machine(site, fault).clock.offset_ns += int(clock_step_s(fault) * 1e9)


def _slip_of(fault: Fault) -> tuple[float, float]:
    """How many times as far, and as much, wheels that slip count: none to twice."""
    return (2.0 * fault.amount, 1.0) if fault.part % 2 else (1.0, 2.0 * fault.amount)


def _slip(site: Site, fault: Fault) -> Undo:
    robot = site.robots[_robot(site, fault)]
    robot.slip = _slip_of(fault)

    def undo() -> None:
        robot.slip = AS_DRIVEN

    return undo


def _slips(site: Site, fault: Fault) -> str:
    (of_way, of_turn), robot = _slip_of(fault), _robot(site, fault)
    return f"odometry of {robot} counts {of_way:.2f} times the way and {of_turn:.2f} times the turn"


def _new_map(site: Site, _fault: Fault) -> None:
    site.edition += 1
    for process in site.machines[SITE].processes:
        if process.name.startswith("mapbuilder"):
            process.stop()


def _floods(fault: Fault) -> bool:
    return fault.amount > 0.7


def _stranger(site: Site, fault: Fault) -> Undo:
    machine = _machine(site, fault)
    session = site.network.open(machine.name, machine.clock)
    period_s = FLOOD_S if _floods(fault) else PERIOD_S
    stranger = Stranger(site, session, f"{site.seed} stranger {fault.at}", period_s)
    stranger.speak()
    return stranger.leave


def _full(site: Site, fault: Fault) -> Undo:
    disk = _process(site, fault).disk
    disk.left = int(5000 * fault.amount)

    def undo() -> None:
        disk.left = None

    return undo


def _of_first_release(site: Site, fault: Fault) -> Undo:
    process = _process(site, fault)
    if not process.is_of_first_release:
        process.is_of_first_release = True
        process.stop()

    def upgrade() -> None:
        process.is_of_first_release = False
        process.stop()

    return upgrade


def _name(site: Site, fault: Fault) -> str:
    return f"the {_process(site, fault).name}"


def _nonsense(_site: Site, fault: Fault) -> str:
    rate = f"{1.0 / FLOOD_S:.0f} times a second " if _floods(fault) else ""
    return f"a stranger publishes nonsense {rate}on {fault.place}"


def _where(site: Site, fault: Fault) -> str:
    return _link(site, fault)[1]


KINDS: dict[str, Kind] = {
    "loss": Kind(
        _set("loss", lambda fault: 0.9 * fault.amount),
        lambda site, fault: f"{90 * fault.amount:.0f} % of messages {_where(site, fault)} are lost",
        _where,
    ),
    "delay": Kind(
        _set("extra_s", lambda fault: 2.0 * fault.amount**2),
        lambda site, fault: f"messages {_where(site, fault)} take {2 * fault.amount**2:.2f} s longer",
        _where,
    ),
    "disorder": Kind(
        _set("disorder_s", lambda fault: fault.amount),
        lambda site, fault: f"messages {_where(site, fault)} overtake others, by up to {fault.amount:.2f} s",
        _where,
    ),
    "duplication": Kind(
        _set("duplication", lambda fault: fault.amount),
        lambda site, fault: f"{100 * fault.amount:.0f} % of messages {_where(site, fault)} come twice",
        _where,
    ),
    "cut": Kind(
        _cut,
        lambda site, fault: f"nothing passes between {_robot(site, fault)} and the site",
        _robot,
    ),
    "kill": Kind(_kill, lambda site, fault: f"{_name(site, fault)} is killed"),
    "kill in a write": Kind(
        _kill_in_write,
        lambda site, fault: f"{_name(site, fault)} is killed {int(20 * fault.amount)} disk operations later",
    ),
    "slip": Kind(_slip, _slips, _robot),
    "first release": Kind(
        _of_first_release,
        lambda site, fault: f"{_name(site, fault)} is of the first release, then upgraded",
        _name,
    ),
    "stop": Kind(_stop, lambda site, fault: f"{_name(site, fault)} is stopped and restarted"),
    "slow": Kind(
        _slow,
        lambda site, fault: f"{_name(site, fault)} needs {0.02 + 0.5 * fault.amount:.2f} s for a message",
        _name,
    ),
    "mute": Kind(_silence, lambda site, fault: f"nothing arrives at {_name(site, fault)}"),
    "off": Kind(_off, lambda _site, fault: f"{fault.place} loses power", lambda _site, fault: fault.place),
    "clock": Kind(
        _clock,
        lambda _site, fault: f"the clock of {fault.place} is set by {clock_step_s(fault):+.2f} s",
    ),
    "new map": Kind(_new_map, lambda _site, _fault: "the mapbuilder is restarted with another map"),
    "stranger": Kind(_stranger, _nonsense, lambda _site, fault: fault),
    "full": Kind(
        _full,
        lambda site, fault: (
            f"the disk of {_name(site, fault)} is full after {int(5000 * fault.amount)} bytes"
        ),
        _name,
    ),
}


def draw(seed: int, plan: Plan) -> list[Fault]:
    """The faults of a seed, in the order of their times."""
    random = Random(f"{seed} faults")
    kinds = sorted(random.sample(sorted(KINDS), random.randint(1, len(KINDS))))
    places = [SITE, *(f"r{number + 1}" for number in range(plan.robots))]
    drawn = [
        Fault(
            at=round(plan.first_s + random.uniform(0.0, plan.faults_s), 3),
            kind=random.choice(kinds),
            place=random.choice(places),
            part=random.randrange(6),
            amount=round(random.random(), 3),
            lasts=round(random.uniform(0.1, plan.longest_s), 3),
        )
        for _ in range(random.randint(1, 4 + 2 * plan.robots))
    ]
    return sorted(drawn, key=lambda fault: fault.at)
