"""What leaves a robot for its site: what the contract's table lets go, as often and urgently as it says."""

import math
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from eigenscan.schemas.channels import CHANNELS, HEALTH, MAP, POSE, RELOCATION, SCAN_RAW, Channel, Role

from tests.fleet.conftest import READY_S, SITE, Fleet, make_fleet, run, until

ROBOT = "r17"
RATE_HZ, SECONDS = 50.0, 3.0
ADDRESS = {"site": SITE, "robot": ROBOT, "instance": ROBOT, "service": "tracker"} | dict.fromkeys(
    ("lidar", "projector", "region"), "one"
)
OWN = [channel for channel in CHANNELS if Role.ROBOT in channel.said_by]
JITTER = 1.2
"""Of a busy machine: the limit holds from sample to sample, not over a second."""


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    fleet = make_fleet(tmp_path_factory.mktemp("air"))
    try:
        for machine in ("site", ROBOT):
            fleet.start(machine)
        yield fleet
    finally:
        fleet.stop()


def count(session: zenoh.Session, heard: Counter[str], selector: str = f"{SITE}/**") -> None:
    session.declare_subscriber(selector, lambda sample: heard.update([str(sample.key_expr)]))


def drive(fleet: Fleet, seconds: float = SECONDS) -> tuple[Counter[str], Counter[str]]:
    """What the site and what the robot's other services hear while one says everything at RATE_HZ."""
    at_site: Counter[str] = Counter()
    on_robot: Counter[str] = Counter()
    with fleet.at_site("recorder") as site, fleet.on_robot(ROBOT) as other, fleet.on_robot(ROBOT) as speaker:
        count(site, at_site)
        count(other, on_robot)

        def arrives() -> bool:
            speaker.put(POSE.key(ADDRESS), b"")
            return bool(at_site[POSE.key(ADDRESS)] and on_robot[POSE.key(ADDRESS)])

        until(arrives, f"nothing arrives\n{fleet.log(ROBOT)}\n{fleet.log('site')}")
        time.sleep(1.0)
        at_site.clear()
        on_robot.clear()
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for channel in OWN:
                speaker.put(channel.key(ADDRESS), b"x", congestion_control=zenoh.CongestionControl.BLOCK)
            time.sleep(1.0 / RATE_HZ)
        time.sleep(0.5)
    return at_site, on_robot


@pytest.fixture(scope="module")
def driven(fleet: Fleet) -> tuple[Counter[str], Counter[str]]:
    return drive(fleet)


@pytest.mark.parametrize("channel", OWN, ids=lambda channel: channel.name)
def test_the_table_decides_what_leaves_the_robot(
    driven: tuple[Counter[str], Counter[str]], channel: Channel
) -> None:
    at_site, everything = (heard[channel.key(ADDRESS)] for heard in driven)
    assert everything > 0.5 * RATE_HZ * SECONDS
    if channel.qos.air_hz == math.inf:
        assert at_site == everything
    else:
        assert at_site <= math.ceil(channel.qos.air_hz * SECONDS * JITTER)
        assert (at_site > 0) == (channel.qos.air_hz > 0)


def test_urgency_over_the_air_is_the_tables_whatever_the_publisher_chose(fleet: Fleet) -> None:
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
    assert samples[0].priority == zenoh.Priority.INTERACTIVE_HIGH
    assert samples[0].congestion_control == zenoh.CongestionControl.DROP
    assert samples[0].express


def test_a_robot_that_is_asked_sends_raw_scans_and_the_others_do_not(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path)
    settings = fleet.folder / "fleet.toml"
    settings.write_text(settings.read_text() + f"\n[robots.{ROBOT}]\nscan_raw = 5.0\npose = 2.0\n")
    fleet.command("configure")
    try:
        for machine in ("site", ROBOT):
            fleet.install(machine)
            fleet.start(machine)
        at_site, _ = drive(fleet, 2.0)
    finally:
        fleet.stop()
    assert 5 <= at_site[SCAN_RAW.key(ADDRESS)] <= 12
    assert 2 <= at_site[POSE.key(ADDRESS)] <= 5
    assert SCAN_RAW.name not in (fleet.folder / "robots/r18/router.json5").read_text()


def test_a_robot_that_floods_is_held_back_at_the_site(fleet: Fleet) -> None:
    """Without its own router in between, and with messages of any size."""
    heard: Counter[str] = Counter()
    sizes: set[int] = set()
    with fleet.at_site("recorder") as site, fleet.past_its_router("r18") as thief:
        key = POSE.key(ADDRESS | {"robot": "r18"})
        count(site, heard)
        site.declare_subscriber(key, lambda sample: sizes.add(len(sample.payload)))

        def arrives() -> bool:
            thief.put(key, b"")
            return heard[key] > 0

        until(arrives, "nothing arrives")
        heard.clear()
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            thief.put(key, b"")
            thief.put(key, bytes(2_000_000))
            time.sleep(0.005)
        time.sleep(0.5)
    assert heard[key] <= 2 * 2.0 * POSE.qos.air_hz * JITTER
    assert sizes == {0}


def test_what_waited_for_a_bad_link_passes_at_once_where_floods_are_not_held_back(tmp_path: Path) -> None:
    fleet, heard = make_fleet(tmp_path), Counter[str]()
    settings = fleet.folder / "fleet.toml"
    settings.write_text(settings.read_text().replace("floods = true", "floods = false"))
    fleet.command("configure")
    fleet.install("site")
    fleet.start("site")
    try:
        with fleet.at_site("recorder") as site, fleet.past_its_router(ROBOT) as robot:
            key = POSE.key(ADDRESS)
            count(site, heard)

            def arrives() -> bool:
                robot.put(key, b"")
                return heard[key] > 0

            until(arrives, "nothing arrives")
            time.sleep(0.5)
            heard.clear()
            for _ in range(10):
                robot.put(key, b"")
            until(lambda: heard[key] == 10, f"{heard[key]} of 10 arrive")
    finally:
        fleet.stop()


def test_a_service_on_the_robot_is_not_commanded_from_the_site(fleet: Fleet) -> None:
    """Only maps and models come in, not what its services tell each other."""
    heard: Counter[str] = Counter()
    with fleet.at_site("mapbuilder") as site, fleet.on_robot(ROBOT) as service:
        for channel in CHANNELS:
            count(service, heard, channel.selector({"site": SITE}))

        def arrives() -> bool:
            for channel in CHANNELS:
                site.put(channel.key(ADDRESS), b"")
            return heard[MAP.key(ADDRESS)] > 10

        until(arrives, "no map comes in")
    own = HEALTH.key(ADDRESS | {"service": "router"})
    assert set(heard) - {own} == {channel.key(ADDRESS) for channel in CHANNELS if channel.qos.latched}


def test_an_operators_word_comes_in_to_the_robot_that_it_is_for(fleet: Fleet) -> None:
    """Through the site's router and the robot's own; nothing else that the operator says does."""
    heard: Counter[str] = Counter()
    with fleet.at_site("operator") as operator, fleet.on_robot(ROBOT) as service:
        for channel in CHANNELS:
            count(service, heard, channel.selector({"site": SITE}))

        def arrives() -> bool:
            for channel in CHANNELS:
                for robot in (ROBOT, "r18"):
                    operator.put(channel.key(ADDRESS | {"robot": robot}), b"")
            return heard[RELOCATION.key(ADDRESS)] > 10

        until(arrives, "no word comes in")
    own = HEALTH.key(ADDRESS | {"service": "router"})
    assert set(heard) - {own} == {RELOCATION.key(ADDRESS)}


def test_a_robot_takes_up_the_operators_word_and_nobody_elses(fleet: Fleet) -> None:
    """A real tracker on the robot; it never hears a scan, so it has no pose to tell of."""
    program = Path(sys.executable).with_name("eigenscan-tracker")
    config = fleet.machines / ROBOT / "service.json5"
    with (fleet.machines / "tracker.log").open("wb") as log:
        tracker = subprocess.Popen(
            [program, "--site", SITE, "--robot", ROBOT, "--zenoh", config], stderr=log, stdout=log
        )
    try:
        for name, taken in (("operator", True), ("recorder", False)):
            own = fleet.machines / ("operator" if name == "operator" else "site") / f"{name}.json5"
            seconds = READY_S if taken else 3.0
            told = run("relocate", ROBOT, "--anew", "--site", SITE, "--zenoh", own, "--seconds", seconds)
            words = "took it up; no pose since" if taken else "did not take it up"
            assert words in (told.stdout if taken else told.stderr)
            assert told.exit_code == (0 if taken else 1)
    finally:
        tracker.terminate()
        tracker.wait(timeout=10)
