"""A stolen robot: one command, and it neither publishes nor receives any more; the others go on."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from eigenscan.schemas.channels import MODEL, POSE

from tests.fleet.conftest import ROBOTS, SITE, ZENOHD, Fleet, make_fleet, run, until

pytestmark = pytest.mark.slow

MODEL_KEY = MODEL.key({"site": SITE, "region": "hall"})


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    fleet = make_fleet(tmp_path)
    try:
        fleet.start("site")
        yield fleet
    finally:
        fleet.stop()


def pose(robot: str) -> str:
    return POSE.key({"site": SITE, "robot": robot})


def test_a_stolen_robot_is_shut_out_by_one_step(fleet: Fleet) -> None:
    received: set[tuple[str, str]] = set()

    def speak() -> None:
        for name, session in published.items():
            session.put(pose(name), b"here")
        mapbuilder.put(MODEL_KEY, b"model")

    def all_received(robots: tuple[str, ...]) -> bool:
        speak()
        return {("recorder", pose(name)) for name in robots} | {
            (name, MODEL_KEY) for name in robots
        } <= received

    with ExitStack() as opened:
        recorder, mapbuilder = (
            opened.enter_context(fleet.at_site(name)) for name in ("recorder", "mapbuilder")
        )
        published = {name: opened.enter_context(fleet.past_its_router(name)) for name in ROBOTS}
        listen(recorder, "recorder", f"{SITE}/**", received)
        for name, session in published.items():
            listen(session, name, MODEL.selector({"site": SITE}), received)
        until(lambda: all_received(ROBOTS), "not all is well before")

        fleet.command("revoke", "r17")
        fleet.install("site")
        fleet.restart_with_the_new_configuration("site")

        received.clear()
        until(lambda: all_received(("r18",)), "r18 is not back")
        for _ in range(20):
            speak()
        until(lambda: all_received(("r18",)), "r18 is gone")
        assert not {("recorder", pose("r17")), ("r17", MODEL_KEY)} & received


def listen(session: zenoh.Session, name: str, selector: str, received: set[tuple[str, str]]) -> None:
    session.declare_subscriber(selector, lambda sample: received.add((name, str(sample.key_expr))))


def test_a_new_certificate_does_not_let_the_old_one_in_again(fleet: Fleet) -> None:
    received: set[bytes] = set()
    stolen = fleet.machines / "stolen"
    (fleet.machines / "r17").rename(stolen)
    (fleet.machines / "r17").mkdir()
    text = (stolen / "router.json5").read_text()
    (stolen / "router.json5").write_text(text.replace(str(fleet.machines / "r17"), str(stolen)))
    fleet.command("revoke", "r17")
    fleet.command("certify", "--robot", "r17")
    for machine in ("site", "r17"):
        fleet.install(machine)
    fleet.restart_with_the_new_configuration("site")
    with (
        fleet.at_site("recorder") as recorder,
        fleet.past_its_router("stolen") as old,
        fleet.past_its_router("r17") as new,
    ):
        recorder.declare_subscriber(pose("r17"), lambda sample: received.add(sample.payload.to_bytes()))

        def speak() -> bool:
            old.put(pose("r17"), b"old")
            new.put(pose("r17"), b"new")
            return b"new" in received

        until(speak, "the new certificate is not let in")
        for _ in range(20):
            speak()
        assert received == {b"new"}


@pytest.mark.skipif(ZENOHD is not None, reason="Zenoh's own router does not look at its configuration again")
def test_a_router_keeps_on_where_the_new_configuration_is_none(fleet: Fleet) -> None:
    (fleet.machines / "site/router.json5").write_text("{ half of")
    until(lambda: "configuration_refused" in fleet.log("site"), "the fault is not told")
    assert fleet.routers["site"].poll() is None


def test_what_revoke_leaves(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    assert run("certify", "--site", SITE, "--address", "h", "--robot", "r17", "-o", folder).exit_code == 0
    done = run("revoke", "r17", "-o", folder)
    assert done.exit_code == 0
    assert not (folder / "robots/r17").exists()
    (kept,) = (folder / "revoked").iterdir()
    assert kept.name.startswith("robot.r17.")
    assert kept.stem not in (folder / "site/router.json5").read_text()
    again = run("revoke", "r17", "-o", folder)
    assert again.exit_code == 2
    assert "r17: has no certificate" in again.stderr
