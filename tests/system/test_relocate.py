"""`eigenscan fleet relocate` beside a robot at work: what it answers, and what becomes of the robot."""

import json
import subprocess
from typing import Any

import pytest
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

from tests.environment import PROGRAMS
from tests.system.house import PATIENCE_S, House
from tests.system.robot import Robot

pytestmark = pytest.mark.slow


def report(house: House, *arguments: object) -> tuple[int, dict[str, Any], str]:
    """Exit code, figures and errors of the command."""
    where = ["--site", house.site, "--zenoh", str(house.config), "--json", "-"]
    done = subprocess.run(
        [PROGRAMS / "eigenscan", "fleet", "relocate", *map(str, arguments), *where],
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, json.loads(done.stdout or "{}"), done.stderr


def test_a_robot_is_relocated_and_the_operator_gets_the_result(house: House) -> None:
    robot = Robot(house.site, house.config)
    house.start("mapbuilder", "--map", robot.write_map(house.logs), "--step", "1.0")
    for service in ("projector", "scan-ingest", "tracker"):
        house.start(service)
    with robot:

        def sure(_: object) -> list[PoseEstimate]:
            return [p for p in house.ear.of(POSE, PoseEstimate) if p.state == STATE_LOCALIZED]

        newest = house.ear.wait_for(sure, "a claim")[-1]
        code, found, _ = report(
            house,
            "robot",
            "--pose",
            newest.pose.x,
            newest.pose.y,
            57.3 * newest.pose.theta,
            "--sigma",
            5.0,  # it drives on until the command is published
            "--seconds",
            PATIENCE_S,
        )
        assert (code, found["taken_up"], found["state"]) == (0, True, "localized")
        assert found["away_m"] < 20.0  # it has driven on since

        code, found, error = report(house, "robot", "--pose", 500, 500, 0, "--seconds", PATIENCE_S)
        assert (code, found["taken_up"], found["state"]) == (1, True, "localized")
        assert "m from --pose: its scans contradict it" in error

        code, found, _ = report(house, "robot", "--search", "--seconds", PATIENCE_S)
        assert (code, found["taken_up"], found["state"]) == (0, True, "localized")
        assert house.ear.health("tracker").counters["relocated"] == 3  # type: ignore[union-attr]

        code, found, error = report(house, "lost", "--search", "--seconds", 8)
        assert (code, found) == (1, {})
        assert "lost: no tracker of it" in error
        assert "robot" in error.rpartition(":")[2]


def test_what_is_asked_wrongly_is_refused_before_anything_is_published(house: House) -> None:
    for wrong, words in (
        (["robot"], "either --pose X Y DEG or --search"),
        (["robot", "--search", "--pose", 1, 2, 3], "either --pose X Y DEG or --search"),
        (["robot", "--pose", "nan", 2, 3], "give finite numbers"),
        (["*", "--search"], "is no robot's name"),
    ):
        code, _, error = report(house, *wrong)
        assert code == 2
        assert words in error
