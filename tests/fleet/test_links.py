"""Who gets a link to the site's router at all: holders of a valid certificate of its authority, over TLS."""

import json
import shutil
import socket
import ssl
from itertools import chain
from pathlib import Path
from typing import Any

import psutil
import pytest
import zenoh
from eigenscan.fleet.authority import Authority
from eigenscan.fleet.diagnosis import diagnose
from eigenscan.fleet.view import FleetView
from eigenscan.schemas.health_pb2 import Health

from tests.fleet.conftest import Fleet, until
from tests.network import free_port

REFUSED_MS, WELCOME_MS = 2000, 120_000
"""Who is refused must not be waited for long; who is welcome may have to wait for a busy machine."""
ALONE = {"scouting": {"multicast": {"enabled": False}}, "mode": "client"}


def opens(endpoint: str, tls: dict[str, Any], wait_ms: int = REFUSED_MS) -> bool:
    """Whether a session that is configured so comes up."""
    config = ALONE | {
        "connect": {"endpoints": [endpoint], "timeout_ms": wait_ms, "exit_on_failure": True},
        "transport": {"link": {"tls": tls}},
    }
    try:
        with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
            return True
    except zenoh.ZError:
        return False


def credentials(folder: Path, name: str, side: str = "connect") -> dict[str, Any]:
    return {
        "root_ca_certificate": str(folder / "ca.crt"),
        f"{side}_certificate": str(folder / f"{name}.crt"),
        f"{side}_private_key": str(folder / f"{name}.key"),
        "enable_mtls": True,
    }


@pytest.fixture
def endpoint(fleet: Fleet) -> str:
    return f"tls/localhost:{fleet.ports['site']}"


def test_a_robot_of_the_fleet_gets_in(fleet: Fleet, endpoint: str) -> None:
    assert opens(endpoint, credentials(fleet.machines / "r17", "robot"), WELCOME_MS)


def test_plaintext_is_refused(fleet: Fleet, endpoint: str) -> None:
    assert not opens(endpoint.replace("tls/", "tcp/"), {})


def test_no_certificate_is_refused(fleet: Fleet, endpoint: str) -> None:
    assert not opens(endpoint, {"root_ca_certificate": str(fleet.machines / "r17/ca.crt")})


def test_another_authoritys_certificate_is_refused(fleet: Fleet, endpoint: str, tmp_path: Path) -> None:
    Authority.create("hospital").issue(tmp_path, "robot", "robot.r17", days=1)
    shutil.copy(fleet.machines / "r17/ca.crt", tmp_path / "ca.crt")  # it trusts the router; not the router it
    assert not opens(endpoint, credentials(tmp_path, "robot"))


def test_an_expired_certificate_is_refused(fleet: Fleet, endpoint: str, tmp_path: Path) -> None:
    Authority.load(fleet.folder / "authority").issue(tmp_path, "robot", "robot.r17", days=0)
    assert not opens(endpoint, credentials(tmp_path, "robot"))


def test_a_router_of_another_name_is_refused(fleet: Fleet, tmp_path: Path) -> None:
    """A robot believes the site's router under the names only that its certificate has."""
    authority = Authority.load(fleet.folder / "authority")
    for name, host, welcome in (("right", "localhost", True), ("wrong", "elsewhere.example", False)):
        authority.issue(tmp_path, name, "site.router", days=1, serves=[host])
        port = free_port()
        with _listener(port, credentials(tmp_path, name, "listen")):
            own, wait_ms = credentials(fleet.machines / "r17", "robot"), WELCOME_MS if welcome else REFUSED_MS
            assert opens(f"tls/localhost:{port}", own, wait_ms) is welcome


def test_a_robot_cannot_pass_itself_off_as_the_router(fleet: Fleet) -> None:
    """Whoever has stolen r18 listens in the router's place, with r18's certificate."""
    port = free_port()
    with _listener(port, credentials(fleet.machines / "r18", "robot", "listen")):
        assert not opens(f"tls/localhost:{port}", credentials(fleet.machines / "r17", "robot"))


def _listener(port: int, tls: dict[str, Any]) -> zenoh.Session:
    config = ALONE | {
        "mode": "router",
        "listen": {"endpoints": [f"tls/127.0.0.1:{port}"]},
        "transport": {"link": {"tls": tls}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def test_the_link_is_the_newest_tls(fleet: Fleet) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(fleet.machines / "r17/ca.crt")
    context.load_cert_chain(fleet.machines / "r17/robot.crt", fleet.machines / "r17/robot.key")
    address = ("localhost", fleet.ports["site"])
    with (
        socket.create_connection(address) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as link,
    ):
        assert link.version() == "TLSv1.3"


def test_a_robots_own_router_is_reached_from_the_robot_only(fleet: Fleet) -> None:
    fleet.start("r17")
    listening = json.loads((fleet.machines / "r17/router.json5").read_text())["listen"]["endpoints"]
    assert listening == [f"tcp/127.0.0.1:{fleet.ports['r17']}"]
    until(lambda: fleet.answers("r17"), "not there for its own services")
    for address in {
        one.address for one in chain(*psutil.net_if_addrs().values()) if one.family == socket.AF_INET
    }:
        with socket.socket() as probe:
            reached = probe.connect_ex((address, fleet.ports["r17"])) == 0
        assert reached == address.startswith("127."), address


def test_a_robots_router_reports_why_it_has_no_link(fleet: Fleet, tmp_path: Path) -> None:
    """It was OK, "routing", and the site's doctor advised to start scan-ingest."""
    own = fleet.install("r18")
    Authority.load(fleet.folder / "authority").issue(tmp_path, "robot", "robot.r18", days=0)
    for name in ("robot.crt", "robot.key"):
        shutil.copy(tmp_path / name, own / name)
    fleet.start("r18")
    with FleetView(fleet.on_robot("r18"), "hospital") as view:
        until(lambda: _router_of(view, "DEGRADED", "has expired"), "the certificate is not named")
        (found,) = [each for each in diagnose(view) if each.where == "router r18"]
        assert "robot.crt has expired" in found.what


def test_a_robots_router_reports_a_site_that_is_out_of_reach(fleet: Fleet) -> None:
    if "r17" not in fleet.routers:
        fleet.start("r17")
    with FleetView(fleet.on_robot("r17"), "hospital") as view:
        until(lambda: _router_of(view, "OK", "routing"), "it has no link")
        fleet.routers["site"].terminate()
        until(lambda: _router_of(view, "DEGRADED", "no link to tls/localhost"), "its end is not reported")
        fleet.routers["site"].wait()
        fleet.start("site")
        until(lambda: _router_of(view, "OK", "routing"), "the new link is not reported")


def _router_of(view: FleetView, status: str, detail: str) -> bool:
    view.update()
    health = view.health("router")
    return (
        health is not None
        and health.status == Health.Status.Value(f"STATUS_{status}")
        and detail in health.detail
    )
