"""`eigenscan fleet fetch` as an operator has it: a recorder on the robot, two routers, certificates."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from eigenscan.runtime.recording import is_complete, read
from eigenscan.schemas.channels import POSE, RECORDINGS_TEMPLATE
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.recordings_pb2 import RecordingParts
from eigenscan.schemas.tracking_pb2 import PoseEstimate

from tests import environment
from tests.command import eigenscan
from tests.fleet.conftest import ROBOTS, SITE, Fleet, make_fleet, until

pytestmark = pytest.mark.slow

R17, R18 = ROBOTS
PATIENCE_S = 5.0
"""What an answer may take; where none is allowed it is waited for so long."""


def key(robot: str, what: str = "parts") -> str:
    return RECORDINGS_TEMPLATE.format(site=SITE, robot=robot, what=what)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    fleet = make_fleet(tmp_path_factory.mktemp("fetch"))
    try:
        for machine in ("site", *ROBOTS):
            fleet.start(machine)
        yield fleet
    finally:
        fleet.stop()


@pytest.fixture(scope="module")
def recorder(fleet: Fleet) -> Iterator[Path]:
    """The recorder of r17, as its eigenscan.toml has it but for the folder; gives that."""
    machine, folder = fleet.machines / R17, fleet.machines / "recordings"
    config = machine / "eigenscan.toml"
    config.write_text(
        config.read_text()
        .replace("/etc/eigenscan", str(machine))
        .replace("/var/lib/eigenscan/recordings", str(folder))
    )
    command = [sys.executable, "-m", "eigenscan.recorder.node", "--config", str(config)]
    with (fleet.machines / "recorder.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, env=environment.clean())
    try:
        yield folder
    finally:
        process.terminate()
        process.wait(60)


@pytest.fixture(scope="module")
def published(fleet: Fleet, recorder: Path) -> int:
    """Poses that the robot published and its recorder wrote; how many."""
    address, number = {"site": SITE, "robot": R17}, 0

    def written() -> int:
        # a file that just began is empty
        files = [path for path in recorder.glob("*.mcap") if path.stat().st_size] if recorder.exists() else []
        return sum(record.envelope.channel is POSE for path in files for record in read(path))

    with fleet.on_robot(R17) as robot:

        def are_written() -> bool:
            nonlocal number
            number += 1
            pose = PoseEstimate(timestamp=stamp(number), model_version=f"{number * 7919:064x}")
            robot.put(POSE.key(address), pose.SerializeToString())
            return written() >= 20

        until(are_written, f"nothing is recorded: {fleet.log('recorder')}")
    return 20


def fetch(fleet: Fleet, robot: str, out: Path) -> subprocess.CompletedProcess[str]:
    config = fleet.machines / "operator/operator.json5"
    return eigenscan(
        "fleet", "fetch", robot, "--from", "1h", "--site", SITE, "--zenoh", config, "--out", out,
        "--seconds", PATIENCE_S, "--json", "-",
    )  # fmt: skip


def test_an_operator_has_what_the_robot_recorded(fleet: Fleet, published: int, tmp_path: Path) -> None:
    done = fetch(fleet, R17, tmp_path / "here")
    assert done.returncode == 0, done.stderr
    reported = json.loads(done.stdout)
    assert reported["bytes_moved"] == sum(file["bytes"] for file in reported["files"]) > 0
    (path,) = (tmp_path / "here" / R17).glob("*.mcap")
    assert is_complete(path)  # though the recorder still writes its own
    assert sum(record.envelope.channel is POSE for record in read(path)) >= published


def test_a_robot_that_does_not_answer_is_named_with_what_may_be_wrong(
    fleet: Fleet, published: int, tmp_path: Path
) -> None:
    done = fetch(fleet, R18, tmp_path / "here")
    assert done.returncode == 1
    assert f"{R18} did not answer within {PATIENCE_S:g} s" in done.stderr
    assert "fleet configure" in done.stderr
    assert not (tmp_path / "here").exists()


def answers(session: zenoh.Session, robot: str) -> list[bytes]:
    replies = session.get(key(robot), timeout=PATIENCE_S, target=zenoh.QueryTarget.ALL)
    return [reply.ok.payload.to_bytes() for reply in replies if reply.ok]


def test_only_the_site_may_ask(fleet: Fleet, published: int) -> None:
    others: dict[str, Callable[[], zenoh.Session]] = {
        "another robot": lambda: fleet.on_robot(R18),
        "a thief of its certificate": lambda: fleet.past_its_router(R18),
        "the mapbuilder": lambda: fleet.at_site("mapbuilder"),
    }
    with fleet.at_site("operator") as operator:
        (allowed,) = answers(operator, R17)
        assert RecordingParts.FromString(allowed).parts
    for who, connect in others.items():
        with connect() as session:
            assert answers(session, R17) == [], who


def test_a_robot_answers_for_its_own_recordings_only(fleet: Fleet, published: int) -> None:
    asked: list[str] = []

    def lie(query: zenoh.Query) -> None:
        asked.append(str(query.key_expr))
        with query:
            query.reply(query.key_expr, b"a lie")

    with fleet.past_its_router(R18) as thief, fleet.at_site("operator") as operator:
        thief.declare_queryable(f"{SITE}/recordings/**", lie)
        thief.declare_queryable(key(R18), lie)
        until(lambda: answers(operator, R18) == [b"a lie"], "it does not answer for itself")
        assert b"a lie" not in answers(operator, R17)
        assert set(asked) == {key(R18)}
