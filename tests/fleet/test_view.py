"""Poses that no tracker publishes: they ended `run --json` and `fleet status --json` as a fault of ours."""

import json
import subprocess
from collections import deque
from itertools import count
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from eigenscan.cli.fleet import metrics
from eigenscan.cli.fleet.status import rows
from eigenscan.fleet.collector import SiteCollector
from eigenscan.fleet.view import FleetView, Robot, Service
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode, encoding

from tests.environment import PROGRAMS
from tests.fleet.conftest import run
from tests.network import free_port

NAN, INF = float("nan"), float("inf")


def _received(view: FleetView, **fields: float) -> list[PoseEstimate]:
    confidence, on_floor = fields.pop("confidence", 0.5), Pose2(x=fields.pop("floor_x", 0.0))
    pose = PoseEstimate(pose=Pose2(**fields), confidence=confidence, floor="ground", floor_pose=on_floor)
    key = POSE.key({"site": "s", "robot": "r1"})
    return [one for _, one in view._receive(Arrival(POSE, key, encode(pose), encoding(POSE)), 1.0, 0)]


def test_poses_of_one_robot_are_given_alone() -> None:
    """`eigenscan run` once showed the pose of another robot on its site."""
    view: Any = FleetView.__new__(FleetView)
    view.site, view.robots, view.services, view._tokens, view._inbox = "s", {}, {}, [], Inbox()

    def put() -> None:
        for x, robot in enumerate(("r1", "r2", "r1"), start=1):
            message, key = PoseEstimate(pose=Pose2(x=x)), POSE.key({"site": "s", "robot": robot})
            view._inbox.put(POSE, key, encode(message), encoding(POSE))

    for of, expected in (("r1", [1.0, 3.0]), ("r2", [2.0]), ("r3", []), (None, [1.0, 2.0, 3.0])):
        put()
        assert [pose.pose.x for pose in view.update(of)] == expected
    assert set(view.robots) == {"r1", "r2"}


@pytest.mark.parametrize(
    "fields",
    [
        {"x": NAN},
        {"y": INF},
        {"theta": 1e308},
        {"x": -1e30},
        {"floor_x": NAN},
        {"confidence": NAN},
        {"confidence": 1e308},
    ],
)
def test_what_is_no_pose_is_not_shown(fields: dict[str, float]) -> None:
    view: Any = FleetView.__new__(FleetView)
    view.site, view.robots, view.services, view.model_versions = "s", {}, {}, deque(maxlen=2)
    view.listed = view.expected = frozenset()
    assert len(_received(view, x=1.0)) == 1
    assert _received(view, **fields) == []
    assert view.robots["r1"].pose.pose.x == 1.0
    json.dumps(rows(view), allow_nan=False)


@pytest.fixture
def operator(tmp_path: Path) -> Path:
    """The configuration of an operator of a robot r17, where nobody else is."""
    path = tmp_path / "operator.json5"
    alone = {"listen": {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}, "metadata": {"robots": ["r17"]}}
    path.write_text(json.dumps({"mode": "peer", "scouting": {"multicast": {"enabled": False}}} | alone))
    return path


def test_the_exporter_shows_a_robot_that_is_not_there(operator: Path) -> None:
    """One that was off when the exporter started was in no metric, so no alert could be on it."""
    where = ["--site", "s", "--zenoh", str(operator), "--port", "0"]
    command = [str(PROGRAMS / "eigenscan"), "fleet", "metrics", *where]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as exporter:
        assert exporter.stdout is not None
        with urlopen(exporter.stdout.readline().strip(), timeout=60.0) as page:
            served = page.read().decode()
        exporter.terminate()
        assert exporter.wait(60.0) == 0
    assert 'eigenscan_robot_state{robot="r17",site="s"} 0.0' in served


def test_the_exporter_names_a_site_of_which_nothing_answers(
    operator: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It served nothing, in silence; a service may still start, so it goes on."""
    updates = count(1)

    def waited(stop: StopEvent, _timeout: float) -> None:
        stop.stopping = next(updates) == 3

    monkeypatch.setattr(metrics, "SILENT_S", 0.0)
    monkeypatch.setattr(StopEvent, "wait", waited)
    done = run("metrics", "--site", "hospitl", "--zenoh", str(operator), "--port", "0")
    assert done.exit_code == 0
    assert done.stderr == (
        "eigenscan fleet metrics: no service of site hospitl answers: check --site, or start its services\n"
    )


def test_what_may_fall_is_no_counter_and_each_site_has_its_own_metrics() -> None:
    """The rate of a gauge has no meaning; two sites may have robots of one name."""
    view: Any = FleetView.__new__(FleetView)
    view.site, view.robots, view.listed, view.expected = "s", {"r1": Robot("r1")}, frozenset(), frozenset()
    counters = {"heard_scan": 9, "waiting": 2, "regions": 7, "mcap_slowest_ms": 29, "lidars": 1}
    view.services = {("mapbuilder", "m"): Service("mapbuilder", "m", {"1"}, Health(counters=counters))}
    samples = [
        (family.type, sample.labels.get("what"), sample.value)
        for family in SiteCollector(view).collect()
        for sample in family.samples
        if sample.labels["site"] == "s"
    ]
    found = {what: (kind, value) for kind, what, value in samples if what}
    assert found == {
        what: ("counter" if what == "heard_scan" else "gauge", value) for what, value in counters.items()
    }
    assert len(samples) == len(found) + 5  # state, up, status, age, clock


@pytest.mark.parametrize("form", ["--once", "--json=-"])
def test_a_site_of_which_nothing_answers_is_named(operator: Path, form: str) -> None:
    """With a wrong --site all robots of the right one were shown as not there, with exit code 0."""
    where = ["--site", "hospitl", "--zenoh", str(operator), "--seconds", "0.5"]
    done = run("status", form, *where)
    assert done.exit_code == 1
    assert "r17" in done.stdout
    assert done.stderr == (
        "eigenscan fleet status: no service of site hospitl answers: check --site, or start its services\n"
    )
