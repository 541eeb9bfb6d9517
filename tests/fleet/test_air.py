"""What leaves a robot for its site: what the contract's table lets go, as often and urgently as it states."""

import json
import math
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
import zenoh
from eigenscan.fleet.configuration import FLOOD as FLOODS_HELD_AT
from eigenscan.schemas.channels import CHANNELS, HEALTH, MAP, POSE, RELOCATION, SCAN, SCAN_RAW, Channel, Role

from tests.fleet.conftest import READY_S, SITE, Fleet, make_fleet, run, until

pytestmark = pytest.mark.slow

ROBOT = "r17"
RATE_HZ, ROUNDS = 50.0, 150
ADDRESS = {"site": SITE, "robot": ROBOT, "instance": ROBOT, "service": "tracker"} | dict.fromkeys(
    ("lidar", "projector", "region", "kind"), "one"
)
OWN = [channel for channel in CHANNELS if Role.ROBOT in channel.published_by]
FLOOD = 300
MARKED = b"x"
"""What is counted; what is published before, until all have met, is empty."""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    """By the table alone, without what fleet.toml asks for beyond it."""
    fleet = make_fleet(tmp_path_factory.mktemp("air"))
    settings = fleet.folder / "fleet.toml"
    settings.write_text(settings.read_text().replace("scan = 2.0", ""))
    fleet.command("configure")
    try:
        for machine in ("site", ROBOT):
            fleet.install(machine)
            fleet.start(machine)
        yield fleet
    finally:
        fleet.stop()


def count(
    session: zenoh.Session, received: Counter[str], selector: str = f"{SITE}/**", payload: bytes | None = None
) -> None:
    """Counts what comes by key; with `payload`, of that only."""

    def on_sample(sample: zenoh.Sample) -> None:
        if payload is None or sample.payload.to_bytes() == payload:
            received[str(sample.key_expr)] += 1

    session.declare_subscriber(selector, on_sample)


def at_most(channel_hz: float, seconds: float) -> int:
    """Samples that a limit lets pass in that time; it holds from sample to sample, the first one passes."""
    return math.floor(channel_hz * seconds) + 1


@dataclass
class Driven:
    """What the site and what the robot's other services received from ROUNDS of everything, by key."""

    at_site: Counter[str]
    on_robot: Counter[str]
    seconds: float
    """From the first word until all had arrived: what passes was limited over no longer time."""


def drive(fleet: Fleet, rounds: int = ROUNDS) -> Driven:
    """One service of the robot publishes everything at RATE_HZ, or as often as the machine lets it."""
    at_site, on_robot, met = Counter[str](), Counter[str](), (Counter[str](), Counter[str]())
    unlimited = [one.key(ADDRESS) for one in OWN if one.qos.air_hz == math.inf]
    crossing = [POSE.key(ADDRESS), *unlimited]
    with fleet.at_site("recorder") as site, fleet.on_robot(ROBOT) as other, fleet.on_robot(ROBOT) as speaker:
        for session, received, first in zip((site, other), (at_site, on_robot), met, strict=True):
            count(session, first)
            count(session, received, payload=MARKED)

        def arrives() -> bool:
            for key in crossing:
                speaker.put(key, b"")
            return all(first[key] for first in met for key in crossing)

        until(arrives, f"nothing arrives\n{fleet.log(ROBOT)}\n{fleet.log('site')}")
        time.sleep(1.0)  # limits count from the last word that was published before
        began = time.monotonic()
        for _ in range(rounds):
            for channel in OWN:
                speaker.put(channel.key(ADDRESS), MARKED, congestion_control=zenoh.CongestionControl.BLOCK)
            time.sleep(1.0 / RATE_HZ)
        until(
            lambda: (
                all(on_robot[channel.key(ADDRESS)] == rounds for channel in OWN)
                and all(at_site[key] == rounds for key in unlimited)
            ),
            f"not all of {rounds} arrive: {on_robot} {at_site}",
        )
        seconds = time.monotonic() - began
        time.sleep(0.5)  # for what should not arrive
    return Driven(at_site, on_robot, seconds)


@pytest.fixture(scope="module")
def driven(fleet: Fleet) -> Driven:
    return drive(fleet)


@pytest.mark.parametrize("channel", OWN, ids=lambda channel: channel.name)
def test_the_table_decides_what_leaves_the_robot(driven: Driven, channel: Channel) -> None:
    key = channel.key(ADDRESS)
    assert driven.on_robot[key] == ROUNDS
    if channel.qos.air_hz == math.inf:
        assert driven.at_site[key] == ROUNDS
    else:
        assert driven.at_site[key] <= min(at_most(channel.qos.air_hz, driven.seconds), ROUNDS)
        assert (driven.at_site[key] > 0) == (channel.qos.air_hz > 0)


def pose_at_site(fleet: Fleet) -> zenoh.Sample:
    """A pose as the recorder receives it, that was published on the robot with other words on its urgency."""
    samples: list[zenoh.Sample] = []
    with fleet.at_site("recorder") as site, fleet.on_robot(ROBOT) as speaker:
        site.declare_subscriber(POSE.key(ADDRESS), samples.append)

        def arrives() -> bool:
            speaker.put(
                POSE.key(ADDRESS), b"", priority=zenoh.Priority.BACKGROUND,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )  # fmt: skip
            return bool(samples)

        until(arrives, "nothing arrives")
    return samples[0]


def test_urgency_over_the_air_is_the_tables_whatever_the_publisher_chose(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path)
    router = fleet.machines / "site" / "router.json5"
    as_it_comes = json.loads(router.read_text())
    del as_it_comes["qos"]  # what the site's router makes of it
    router.write_text(json.dumps(as_it_comes))
    try:
        for machine in ("site", ROBOT):
            fleet.start(machine)
        pose = pose_at_site(fleet)
    finally:
        fleet.stop()
    assert pose.priority == zenoh.Priority.INTERACTIVE_HIGH
    assert pose.congestion_control == zenoh.CongestionControl.DROP
    assert pose.express


def test_from_the_sites_router_poses_of_many_robots_leave_together(fleet: Fleet) -> None:
    """Each in a batch of its own, those of 200 robots would not fit into a subscriber's queue."""
    pose = pose_at_site(fleet)
    assert pose.priority == zenoh.Priority.INTERACTIVE_HIGH
    assert not pose.express


def test_a_robot_that_is_asked_sends_raw_scans_and_the_others_do_not(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path)
    settings = fleet.folder / "fleet.toml"
    settings.write_text(settings.read_text() + f"\n[robots.{ROBOT}]\nscan_raw = 5.0\npose = 2.0\n")
    fleet.command("configure")
    try:
        for machine in ("site", ROBOT):
            fleet.install(machine)
            fleet.start(machine)
        driven = drive(fleet)
    finally:
        fleet.stop()
    as_shipped = (SCAN, 2.0)  # by which the mapbuilder keeps the map true
    for channel, asked_hz in ((SCAN_RAW, 5.0), (POSE, 2.0), as_shipped):
        assert 2 <= driven.at_site[channel.key(ADDRESS)] <= at_most(asked_hz, driven.seconds)
    assert SCAN_RAW.name not in (fleet.folder / "robots/r18/router.json5").read_text()


def test_a_robot_that_floods_is_held_back_at_the_site(fleet: Fleet) -> None:
    """Without its own router in between, and with messages of any size."""
    received, met = Counter[str](), Counter[str]()
    sizes: set[int] = set()
    with fleet.at_site("recorder") as site, fleet.past_its_router("r18") as thief:
        key = POSE.key(ADDRESS | {"robot": "r18"})
        count(site, received, payload=MARKED)
        count(site, met)
        site.declare_subscriber(key, lambda sample: sizes.add(len(sample.payload)))

        def arrives() -> bool:
            thief.put(key, b"")
            return met[key] > 0

        until(arrives, "nothing arrives")
        began = time.monotonic()
        for _ in range(FLOOD):
            for _ in range(10):
                thief.put(key, MARKED)
            thief.put(key, bytes(2_000_000))
            time.sleep(0.005)
        # its last word passes as well, once the limit lets another one
        last = Counter[str]()
        count(site, last, payload=b"last")

        def is_last() -> bool:
            thief.put(key, b"last")
            return last[key] > 0

        until(is_last, "what comes after the flood does not arrive")
        seconds = time.monotonic() - began
    assert received[key] <= at_most(FLOODS_HELD_AT * POSE.qos.air_hz, seconds)
    assert sizes == {0, len(MARKED), len(b"last")}


def test_a_query_is_no_larger_than_a_message(fleet: Fleet) -> None:
    key, sizes = MAP.key(ADDRESS), list[int]()

    def answer(query: zenoh.Query) -> None:
        sizes.append(len(query.payload or b""))
        query.reply(key, b"map")

    with fleet.at_site("mapbuilder") as site, fleet.past_its_router("r18") as thief:
        queryable = site.declare_queryable(key, answer)
        until(lambda: bool([*thief.get(key, payload=b"x", timeout=2.0)]), "nobody answers")
        assert not [*thief.get(key, payload=bytes(2_000_000), timeout=5.0)]
        assert [*thief.get(key, payload=b"xy", timeout=5.0)]
        queryable.undeclare()
    assert set(sizes) == {1, 2}


def test_what_waited_for_a_bad_link_passes_at_once_where_floods_are_not_held_back(tmp_path: Path) -> None:
    fleet, received, met = make_fleet(tmp_path), Counter[str](), Counter[str]()
    settings = fleet.folder / "fleet.toml"
    settings.write_text(settings.read_text().replace("floods = true", "floods = false"))
    fleet.command("configure")
    fleet.install("site")
    fleet.start("site")
    try:
        with fleet.at_site("recorder") as site, fleet.past_its_router(ROBOT) as robot:
            key = POSE.key(ADDRESS)
            count(site, received, payload=MARKED)
            count(site, met)

            def arrives() -> bool:
                robot.put(key, b"")
                return met[key] > 0

            until(arrives, "nothing arrives")
            for _ in range(10):
                robot.put(key, MARKED)
            until(lambda: received[key] == 10, f"{received[key]} of 10 arrive")
    finally:
        fleet.stop()


def test_a_service_on_the_robot_is_not_commanded_from_the_site(fleet: Fleet) -> None:
    """Only maps and models come in, not what its services show each other."""
    received: Counter[str] = Counter()
    with fleet.at_site("mapbuilder") as site, fleet.on_robot(ROBOT) as service:
        for channel in CHANNELS:
            count(service, received, channel.selector({"site": SITE}))

        def arrives() -> bool:
            for channel in CHANNELS:
                site.put(channel.key(ADDRESS), b"")
            return received[MAP.key(ADDRESS)] > 10

        until(arrives, "no map comes in")
    own = HEALTH.key(ADDRESS | {"service": "router"})
    assert set(received) - {own} == {channel.key(ADDRESS) for channel in CHANNELS if channel.qos.latched}


def test_an_operators_word_comes_in_to_the_robot_that_it_is_for(fleet: Fleet) -> None:
    """Through the site's router and the robot's own; nothing else from the operator does."""
    received: Counter[str] = Counter()
    with fleet.at_site("operator") as operator, fleet.on_robot(ROBOT) as service:
        for channel in CHANNELS:
            count(service, received, channel.selector({"site": SITE}))

        def arrives() -> bool:
            for channel in CHANNELS:
                for robot in (ROBOT, "r18"):
                    operator.put(channel.key(ADDRESS | {"robot": robot}), b"")
            return received[RELOCATION.key(ADDRESS)] > 10

        until(arrives, "no word comes in")
    own = HEALTH.key(ADDRESS | {"service": "router"})
    assert set(received) - {own} == {RELOCATION.key(ADDRESS)}


def test_a_robot_takes_up_the_operators_word_and_nobody_elses(fleet: Fleet) -> None:
    """A real tracker on the robot; it never receives a scan, so it has no pose to publish."""
    program = Path(sys.executable).with_name("eigenscan-tracker")
    config = fleet.machines / ROBOT / "service.json5"
    with (fleet.machines / "tracker.log").open("wb") as log:
        tracker = subprocess.Popen(
            [program, "--site", SITE, "--robot", ROBOT, "--zenoh", config], stderr=log, stdout=log
        )
    health, received = HEALTH.key(ADDRESS), Counter[str]()
    try:
        with fleet.at_site("recorder") as site:
            count(site, received, health)
            until(lambda: received[health] > 0, f"no tracker\n{fleet.log('tracker')}")
        for name, taken in (("operator", True), ("recorder", False)):
            own = fleet.machines / ("operator" if name == "operator" else "site") / f"{name}.json5"
            seconds = 20.0 if taken else 3.0
            reported = run(
                "relocate", ROBOT, "--search", "--site", SITE, "--zenoh", own, "--seconds", seconds
            )
            words = "accepted it; no pose since then" if taken else "did not answer within"
            assert words in (reported.stdout if taken else reported.stderr)
            assert reported.exit_code == (0 if taken else 1)
    finally:
        tracker.terminate()
        tracker.wait(READY_S)
