"""A projector that serves a group of robots from elsewhere: its certificate names its keys."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from eigenscan.fleet.configuration import INSTALLED
from eigenscan.geometry.gridmap import write_map
from eigenscan.schemas.channels import (
    CHANNELS,
    HEALTH,
    HYPOTHESES,
    LIDAR_KIND,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    POSE,
    SCAN,
    SPACE,
    Channel,
)
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.simulation.world import office

from tests.fleet.conftest import SITE, Fleet, run, until
from tests.network import free_port

pytestmark = pytest.mark.slow

ROBOTS = ("a-1", "b-7", "c-1")
SERVED = ("a-1", "b-7")
LAB = "lab"
GROUP = "a-*,b-7"
PROGRAMS = Path(sys.executable).parent
HOLDERS = (*ROBOTS, LAB, "mapbuilder", "recorder")
RECEIVED, PUBLISHED = (SCAN, MAP, MODEL, MODEL_SET), (HYPOTHESES, OBSTACLES, HEALTH)
ROUNDS, PAUSE_S = 5, 0.1


def key_of(channel: Channel, owner: str) -> str:
    """The channel's key of a robot, as `owner` would publish it: a projector's ends with its own name."""
    fields = {"site": SITE, "robot": owner, "lidar": "front", "projector": LAB, "region": "hall", "kind": "k"}
    service = "projector" if owner == LAB else owner if owner in ("mapbuilder", "recorder") else "tracker"
    return channel.key(fields | {"instance": owner, "service": service})


WHAT = [(channel, owner) for channel in CHANNELS for owner in HOLDERS]
Received = set[tuple[str, str, str]]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    path = tmp_path_factory.mktemp("groups")
    fleet = Fleet(path / "fleet", path / "machines", {name: free_port() for name in ("site", *ROBOTS)})
    robots = [word for name in ROBOTS for word in ("--robot", name)]
    fleet.command("certify", "--site", SITE, "--address", "localhost", *robots)
    settings = fleet.folder / "fleet.toml"
    text = settings.read_text().replace("[groups]", f'[groups]\n{LAB} = "{GROUP}"')
    settings.write_text(text.replace("scan = 2.0", "pose = 1000.0\ntracks = 1000.0\nadvice = 1000.0"))
    assert f"groups/{LAB}" in fleet.command("certify").stdout
    for machine in ("site", *ROBOTS, f"groups/{LAB}"):
        fleet.install(machine)
    try:
        fleet.start("site")
        yield fleet
    finally:
        fleet.stop()


def session_of(fleet: Fleet, holder: str) -> zenoh.Session:
    if holder in ROBOTS:
        return fleet.past_its_router(holder)
    if holder == LAB:
        return zenoh.open(zenoh.Config.from_file(str(fleet.machines / "groups" / LAB / "projector.json5")))
    return fleet.at_site(holder)


@pytest.fixture(scope="module")
def received(fleet: Fleet) -> Received:
    """Who received which key of whom, after everybody published every key."""
    reported: Received = set()
    with ExitStack() as opened:
        sessions = {holder: opened.enter_context(session_of(fleet, holder)) for holder in HOLDERS}
        for holder, session in sessions.items():

            def on_sample(sample: zenoh.Sample, holder: str = holder) -> None:
                reported.add(
                    (holder, str(sample.key_expr), sample.payload.to_bytes().decode(errors="replace"))
                )

            selectors = {"**", f"{SITE}/**", *(channel.selector({"site": SITE}) for channel in CHANNELS)}
            # a rule is asked for the subscription as it stands: that of a group is one for each pattern
            selectors |= {f"{SITE}/robot/a-$*/scan/*", f"{SITE}/robot/b-7/scan/*"}
            for selector in selectors:
                session.declare_subscriber(selector, on_sample, allowed_origin=zenoh.Locality.REMOTE)
        expected = {
            *((LAB, key_of(SCAN, robot), robot) for robot in SERVED),
            *(
                (who, key_of(channel, robot), LAB)
                for channel in (HYPOTHESES, OBSTACLES)
                for robot in SERVED
                for who in (robot, "mapbuilder", "recorder")
            ),
            *(("recorder", key_of(POSE, robot), robot) for robot in ROBOTS),
            *((LAB, key_of(channel, "mapbuilder"), "mapbuilder") for channel in (MAP, MODEL, MODEL_SET)),
            *((who, key_of(HEALTH, LAB), LAB) for who in ("mapbuilder", "recorder")),
        }

        def published() -> bool:
            for holder, session in sessions.items():
                for channel, owner in WHAT:
                    session.put(key_of(channel, owner), holder)
            return expected <= reported

        until(published, "not all that is allowed has arrived")
        for _ in range(ROUNDS):
            published()
            time.sleep(PAUSE_S)
    return reported  # with no session open: nothing comes while it is looked through


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_a_groups_projector_receives_its_robots_scans_and_the_sites_models_only(
    received: Received, channel: Channel
) -> None:
    for owner in HOLDERS:
        sayers = {by for who, key, by in received if who == LAB and key == key_of(channel, owner)} - {LAB}
        if channel is SCAN:
            assert sayers == ({owner} if owner in SERVED else set())
        else:
            assert sayers == ({"mapbuilder"} if channel in (MAP, MODEL, MODEL_SET, SPACE) else set())


@pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)
def test_a_groups_projector_answers_its_robots_only(received: Received, channel: Channel) -> None:
    for owner in HOLDERS:
        subscribers = {who for who, key, by in received if by == LAB and key == key_of(channel, owner)} - {
            LAB
        }
        if channel in (HYPOTHESES, OBSTACLES) and owner in SERVED:
            assert subscribers == {owner, "mapbuilder", "recorder"}
        elif (channel is HEALTH and owner == LAB) or (channel is LIDAR_KIND and owner in SERVED):
            assert subscribers == {"mapbuilder", "recorder"}
        else:
            assert subscribers == set()


def test_no_robot_receives_another_ones_answers_and_none_of_them_answers(received: Received) -> None:
    for who, key, by in received:
        for channel in (HYPOTHESES, OBSTACLES):
            if channel.parse(key):
                assert by == LAB
                assert who in {"mapbuilder", "recorder", key.split("/")[2]}


def test_a_scan_goes_from_the_robot_to_its_groups_projector_and_the_answer_back(fleet: Fleet) -> None:
    """Through the robot's own router."""
    for robot in ("a-1", "c-1"):
        if robot not in fleet.routers:
            fleet.start(robot)
    scans, answers = set[str](), set[str]()
    with ExitStack() as opened:
        lab = opened.enter_context(session_of(fleet, LAB))
        on_robot = {robot: opened.enter_context(fleet.on_robot(robot)) for robot in ("a-1", "c-1")}
        lab.declare_subscriber(f"{SITE}/robot/a-$*/scan/*", lambda sample: scans.add(str(sample.key_expr)))
        for session in on_robot.values():
            selector = HYPOTHESES.selector({"site": SITE})
            session.declare_subscriber(selector, lambda sample: answers.add(str(sample.key_expr)))

        def arrives() -> bool:
            for robot, session in on_robot.items():
                session.put(key_of(SCAN, robot), b"")
                lab.put(key_of(HYPOTHESES, robot), b"")
            return bool(scans and answers)

        until(arrives, f"nothing arrives\n{fleet.log('a-1')}\n{fleet.log('site')}")
        for _ in range(ROUNDS):
            arrives()
            time.sleep(PAUSE_S)
    assert scans == {key_of(SCAN, "a-1")}
    assert answers == {key_of(HYPOTHESES, "a-1")}


def test_a_group_that_cannot_be_is_refused_by_name(fleet: Fleet) -> None:
    settings = fleet.folder / "fleet.toml"
    whole = settings.read_text()
    try:
        for group, words in ((f'{LAB} = "a b"', "is no robot"), ('a-1 = "b-7"', "is a robot's name as well")):
            settings.write_text(whole.replace(f'{LAB} = "{GROUP}"', group))
            refused = run("certify", "-o", fleet.folder)
            assert refused.exit_code == 2
            assert words in refused.stderr
    finally:
        settings.write_text(whole)


def test_a_robot_finds_itself_by_its_groups_projector(fleet: Fleet, tmp_path: Path) -> None:
    """Real services: ingest and tracker on the robot, the projector elsewhere, models from the site."""
    write_map(office().render(), tmp_path / "map.yaml")
    build = [PROGRAMS / "eigenscan", "build", tmp_path / "map.yaml", "-o", tmp_path / "model"]
    subprocess.run(list(map(str, build)), check=True, stdout=subprocess.DEVNULL)
    if "a-1" not in fleet.routers:
        fleet.start("a-1")
    own, lab = fleet.machines / "a-1" / "service.json5", fleet.machines / "groups" / LAB
    settings = lab / "eigenscan.toml"
    settings.write_text(settings.read_text().replace(INSTALLED, str(lab)))
    robot = ["--site", SITE, "--robot", "a-1", "--zenoh", own]
    commands: list[list[object]] = [
        ["mapbuilder", "--site", SITE, "--zenoh", fleet.machines / "site/mapbuilder.json5"],
        ["projector", "--config", settings],
        ["scan-ingest", *robot],
        ["tracker", *robot],
    ]
    commands[0] += ["--instance", "site", "--model", tmp_path / "model", "--changes", "off"]
    drive = [PROGRAMS / "eigenscan", "simulate", "--map", tmp_path / "map.yaml", "--live", "--seconds", 300]
    clean = {name: value for name, value in os.environ.items() if not name.startswith("EIGENSCAN_")}
    claims: list[PoseEstimate] = []

    def on_pose(sample: zenoh.Sample) -> None:
        pose = PoseEstimate.FromString(sample.payload.to_bytes())
        claims.extend([pose] if pose.state == STATE_LOCALIZED else [])

    with ExitStack() as opened, (tmp_path / "log").open("wb") as log:
        site = opened.enter_context(fleet.at_site("recorder"))
        site.declare_subscriber(POSE.key({"site": SITE, "robot": "a-1"}), on_pose)
        for command in [[PROGRAMS / f"eigenscan-{name}", *rest] for name, *rest in commands] + [
            [*drive, *robot]
        ]:
            process = subprocess.Popen(list(map(str, command)), stdout=log, stderr=log, env=clean)
            opened.callback(process.wait)
            opened.callback(process.terminate)
        until(lambda: len(claims) >= 10, f"not localized\n{(tmp_path / 'log').read_text()}", 120.0)


def test_a_groups_projector_is_revoked_as_a_robot_is(fleet: Fleet) -> None:
    router, robot = fleet.folder / "site/router.json5", fleet.folder / "robots/a-1/router.json5"
    assert f"group.{LAB}" in router.read_text()
    assert "/hypotheses/" in robot.read_text()
    try:
        fleet.command("revoke", LAB)
        assert f"group.{LAB}" not in router.read_text()
        assert not (fleet.folder / f"groups/{LAB}/projector.key").exists()
        # nothing is let in for it any more
        ingress = [
            rule
            for rule in json.loads(robot.read_text())["access_control"]["rules"]
            if "ingress" in rule["flows"]
        ]
        assert not [rule for rule in ingress if any("/hypotheses/" in key for key in rule["key_exprs"])]
    finally:
        for revoked in (fleet.folder / "revoked").glob("group.*"):
            revoked.unlink()
        fleet.command("certify")
