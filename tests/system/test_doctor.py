"""`eigenscan doctor` and `eigenscan fleet status` beside real services and real faults."""

import json
import subprocess
import threading
import time
from collections.abc import Iterator
from itertools import count
from pathlib import Path
from typing import Any

import pytest
import zenoh
from eigenscan.schemas.channels import ALIVE_TEMPLATE, HEALTH, SCAN
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import encode, encoding

from tests.system.house import PROGRAMS, House
from tests.system.robot import Robot


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


def test_a_site_at_work_is_well_and_then_each_fault_is_found(house: House) -> None:
    robot = Robot(house.site, house.config)
    map_file = robot.write_map(house.logs)
    for service in ("projector", "tracker", "scan-ingest"):
        house.start(service)
    where, site = "robot robot", f"site {house.site}"
    assert complaints(house) == [
        (site, "no mapbuilder: who starts now gets no model"),
        (where, "no scans come"),
    ]
    with robot:
        assert (where, "projector: no model") in complaints(house)
        house.start("mapbuilder", "--map", map_file, "--step", "1.0")
        house.until("tracker", lambda health: health.counters["heard_hypotheses"] > 10, "hears hypotheses")
        assert complaints(house) == []

        _, seen = ask(house, "fleet", "status")
        (row,) = seen["robots"]
        assert (row["robot"], row["state"], row["model"]) == ("robot", "localized", seen["model"])
        assert row["pose_age_s"] < 2.0
        assert row["services"] == dict.fromkeys(("projector", "tracker", "scan-ingest"), "ok")

        robot.odometry.clear()
        assert [what.split(":")[0] for _, what in complaints(house)] == ["no odometry comes"]
        robot.odometry.set()
        house.kill("tracker")
        assert complaints(house, "--robot", "lost") == [
            *(("robot lost", f"no {service}") for service in ("scan-ingest", "projector", "tracker")),
            (where, "no tracker"),
        ]


def test_a_dead_router_is_named(house: House, tmp_path: Path) -> None:
    config = tmp_path / "dead.json5"
    endpoints = {"endpoints": ["tcp/127.0.0.1:1"], "timeout_ms": -1, "exit_on_failure": False}
    config.write_text(json.dumps({"mode": "client", "connect": endpoints}))
    code, (finding,) = ask(house, "doctor", config=config)
    assert code == 1
    assert finding["where"] == "router"
    assert str(config) in finding["mend"]


def test_an_empty_site_is_named(house: House) -> None:
    assert complaints(house) == [(f"site {house.site}", "nobody is there")]


@pytest.fixture
def stranger(house: House) -> Iterator[dict[str, Any]]:
    """A projector of another release, a minute behind, that drops scans; what it says can be changed."""
    said: dict[str, Any] = {"status": Health.STATUS_OK, "detail": ""}
    who = {"site": house.site, "service": "projector", "instance": "old"}
    token = house.session.liveliness().declare_token(ALIVE_TEMPLATE.format(**who, contract=99))
    stop = threading.Event()

    def speak() -> None:
        for number in count():
            message = Health(
                timestamp=stamp(time.time_ns() - 60_000_000_000),
                service="projector",
                instance="old",
                counters={f"dropped_{SCAN.name}": 3 * number, "undecodable": number},
                **said,
            )
            house.session.put(HEALTH.key(who), encode(message), encoding=zenoh.Encoding(encoding(HEALTH)))
            if stop.wait(0.2):
                return

    speaking = threading.Thread(target=speak)
    speaking.start()
    yield said
    stop.set()
    speaking.join()
    token.undeclare()


def test_another_release_a_wrong_clock_and_drops_are_named(house: House, stranger: dict[str, Any]) -> None:
    stranger |= {"status": Health.STATUS_DEGRADED, "detail": "disk full"}
    said = [what for where, what in complaints(house) if where == "projector old"]
    assert said[:3] == [
        "speaks version 99 of the contract, this command 1",
        "its clock is 60 s behind",
        "disk full",
    ]
    assert said[3].startswith("could not decode ")
    assert said[4].startswith("is too slow: drops scan, ")
    assert len(said) == 5
