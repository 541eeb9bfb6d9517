"""`eigenscan doctor` and `eigenscan fleet status` beside real services and real faults."""

import json
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import zenoh
from eigenscan.schemas.channels import ALIVE_TEMPLATE, CONTRACT_VERSION, HEALTH, SCAN
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import encode, encoding

from tests.environment import PROGRAMS
from tests.system.house import PATIENCE_S, House, eventually
from tests.system.robot import Robot

pytestmark = pytest.mark.slow


def ask(house: House, *command: str, config: Path | None = None) -> tuple[int, Any]:
    """Exit code and JSON of a command on the house's site."""
    done = subprocess.run(
        [
            PROGRAMS / "eigenscan",
            *command,
            "--site",
            house.site,
            "--zenoh",
            config or house.config,
            "--json",
            "-",
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout)


def complaints(house: House, *flags: str) -> list[tuple[str, str]]:
    """Place and fault of all that doctor finds."""
    code, found = ask(house, "doctor", "--seconds", "2.5", *flags)
    assert code == (1 if found else 0)
    assert all(finding["mend"] for finding in found)
    return [(finding["where"], finding["what"]) for finding in found]


def until_it_finds(house: House, *wanted: tuple[str, str], flags: Sequence[str] = ()) -> None:
    """Doctor finds this and nothing else: on a busy machine once all has come that it has to receive."""
    found: list[tuple[str, str]] = []

    def finds() -> bool:
        found[:] = complaints(house, *flags)
        return found == list(wanted)

    eventually(finds, f"doctor to find {wanted}", found)


def test_a_site_at_work_is_well_and_then_each_fault_is_found(house: House) -> None:
    robot = Robot(house.site, house.config)
    map_file = robot.write_map(house.logs)
    for service in ("projector", "tracker", "scan-ingest"):
        house.start(service)
    where, site = "robot robot", f"site {house.site}"
    no_map = (site, "no mapbuilder: a projector that starts now gets no model")
    until_it_finds(house, no_map, (where, "no scans arrive"))
    with robot:
        eventually(lambda: (where, "projector: no model") in complaints(house), "a word on the model")
        house.start("mapbuilder", "--map", map_file, "--step", "1.0")
        house.until("tracker", lambda health: health.counters["heard_hypotheses"] > 10, "hears hypotheses")
        until_it_finds(house)

        _, seen = ask(house, "fleet", "status")
        (row,) = seen["robots"]
        assert (row["robot"], row["state"], row["model"]) == ("robot", "localized", seen["model"])
        assert 0.0 <= row["pose_age_s"] < PATIENCE_S
        assert row["services"] == dict.fromkeys(("projector", "tracker", "scan-ingest"), "ok")

        robot.odometry.clear()
        found: list[str] = []

        def names_odometry_alone() -> bool:
            """The doctor by counters, and the tracker in its health."""
            found[:] = [what for _, what in complaints(house)]
            counted = [what for what in found if what.startswith("no odometry arrives:")]
            stated = [what for what in found if "no odometry of the last" in what]
            return len(found) == 2 and len(counted) == len(stated) == 1

        eventually(names_odometry_alone, "two words on the odometry", found)
        robot.odometry.set()
        house.kill("tracker")
        nobody = ("robot lost", "nothing of it is there: it or its link is off")
        until_it_finds(house, nobody, (where, "no tracker"), flags=("--robot", "lost"))


def test_a_dead_router_is_named(house: House, tmp_path: Path) -> None:
    config = tmp_path / "dead.json5"
    endpoints = {"endpoints": ["tcp/127.0.0.1:1"], "timeout_ms": -1, "exit_on_failure": False}
    config.write_text(json.dumps({"mode": "client", "connect": endpoints}))
    code, (finding,) = ask(house, "doctor", config=config)
    assert code == 1
    assert finding["where"] == "router"
    assert str(config) in finding["mend"]


def test_an_empty_site_is_named(house: House) -> None:
    until_it_finds(house, (f"site {house.site}", "no service of this site is reachable"))


@contextmanager
def speaking(
    house: House, service: str, instance: str, contract: int, words: Callable[[int], dict[str, Any]]
) -> Iterator[None]:
    """An instance of a service that publishes its health five times a second, `words` by its number."""
    who = {"site": house.site, "service": service, "instance": instance}
    token = house.session.liveliness().declare_token(ALIVE_TEMPLATE.format(**who, contract=contract))
    stop = threading.Event()

    def speak() -> None:
        for number in count():
            given: dict[str, Any] = {"timestamp": stamp(time.time_ns()), "status": Health.STATUS_OK} | words(
                number
            )
            message = Health(service=service, instance=instance, **given)
            house.session.put(HEALTH.key(who), encode(message), encoding=zenoh.Encoding(encoding(HEALTH)))
            if stop.wait(0.2):
                return

    thread = threading.Thread(target=speak)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
        token.undeclare()


@pytest.fixture
def stranger(house: House) -> Iterator[dict[str, Any]]:
    """A projector of another release, a minute behind, that drops scans; what it reports can be changed."""
    published: dict[str, Any] = {"status": Health.STATUS_OK, "detail": ""}

    def words(number: int) -> dict[str, Any]:
        behind = stamp(time.time_ns() - 60_000_000_000)
        counters = {f"dropped_{SCAN.name}": 3 * number, "undecodable": number}
        return {"timestamp": behind, "counters": counters, **published}

    with speaking(house, "projector", "old", 99, words):
        yield published


def test_another_release_a_wrong_clock_and_drops_are_named(house: House, stranger: dict[str, Any]) -> None:
    stranger |= {"status": Health.STATUS_DEGRADED, "detail": "disk full"}
    wanted = [
        "speaks version 99 of the contract, this command 1",
        "its clock is 6[0-9] s behind",
        "disk full",
        "could not decode .*",
        "is too slow: drops scan, .*",
    ]
    published: list[str] = []

    def finds() -> bool:
        published[:] = [what for where, what in complaints(house) if where == "projector old"]
        return len(published) == len(wanted) and all(map(re.fullmatch, wanted, published))

    eventually(finds, "doctor to find all of it", published)


def test_two_trackers_of_one_robot_and_a_part_that_nobody_searches_are_named(house: House) -> None:
    there = [
        ("scan-ingest", "0", {"robot": "*"}),
        ("tracker", "a-+", {"robot": "a-*"}),
        ("tracker", "a-1", {"robot": "a-1,b-1"}),
        ("projector", "a-+-1of3", {"robot": "a-*", "part": "1/3"}),
        ("projector", "a-+-3of3", {"robot": "a-*", "part": "3/3"}),
        ("projector", "b-+", {"robot": "b-*", "part": "1/1"}),
    ]
    with ExitStack() as stack:
        for service, instance, settings in there:
            reported = json.dumps(settings)

            def words(number: int, reported: str = reported) -> dict[str, Any]:
                return {"settings": reported, "counters": {"heard_scan_raw": number}}

            stack.enter_context(speaking(house, service, instance, CONTRACT_VERSION, words))
        wanted = [
            ("robot a-1", "has tracker a-+ and a-1: both publish on the same keys"),
            ("robot a-1", "no projector searches part 2/3 of the site"),
            ("robot b-2", "no tracker"),
        ]
        eventually(lambda: complaints(house, "--robot", "b-2")[1:] == wanted, "doctor to find all of it")
