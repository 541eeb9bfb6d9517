"""A connection that stands while no link to a router goes by it, of real sockets and sessions."""

import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
import zenoh
from eigenscan.runtime import link_watchdog

from tests.network import free_port
from tests.runtime.conftest import PATIENCE_S

ALONE = {"scouting": {"multicast": {"enabled": False}}}


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server


@pytest.mark.parametrize(
    ("endpoints", "ports"),
    [
        (["tls/[fd00::5]:7447", "tcp/site.example:7448"], [7447, 7448]),
        ("tcp/10.0.0.1:7447#iface=eth0", [7447]),
        ({"router": ["tcp/a:1"], "peer": ["quic/b:2?rel=1"]}, [1, 2]),
        (["unixpipe/pipe"], []),
        ([], []),
    ],
)
def test_ports_of_endpoints(endpoints: object, ports: list[int]) -> None:
    assert list(link_watchdog.ports_of(endpoints)) == ports


def test_ones_own_connections_count_while_they_stand(server: socket.socket) -> None:
    port = server.getsockname()[1]
    assert not link_watchdog.is_connected({port})
    with socket.create_connection(("127.0.0.1", port)):
        assert link_watchdog.is_connected({port})
        assert not link_watchdog.is_connected({port + 1})
    assert not link_watchdog.is_connected({port})


def waits(config: Path, session: zenoh.Session) -> threading.Event:
    """Set once the link is found link_watchdog."""
    found = threading.Event()

    def run() -> None:
        if link_watchdog.await_dead_link(config, session):
            found.set()

    threading.Thread(target=run, daemon=True).start()
    return found


def test_a_connection_without_a_link_passes_nothing(
    server: socket.socket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connection is a plain one of this process, as one that Zenoh has forgotten."""
    monkeypatch.setattr(link_watchdog, "DEAD_S", 1.0)
    monkeypatch.setattr(link_watchdog, "LOOK_EVERY_S", 0.05)
    router, config = f"tcp/127.0.0.1:{free_port()}", tmp_path / "robot.json5"
    port = server.getsockname()[1]
    listening = zenoh.Config.from_json5(
        json.dumps(ALONE | {"mode": "router", "listen": {"endpoints": [router]}})
    )
    config.write_text(json.dumps({"connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}))
    linked = zenoh.Config.from_json5(json.dumps(ALONE | {"connect": {"endpoints": [router]}}))
    alone = zenoh.Config.from_json5(json.dumps(ALONE))
    with zenoh.open(listening), zenoh.open(linked) as received, zenoh.open(alone) as unheard:
        assert received.info.routers_zid()
        early, well = waits(config, unheard), waits(config, received)
        assert not early.wait(3.0)  # cut off is not dead
        with socket.create_connection(("127.0.0.1", port)):
            assert early.wait(PATIENCE_S)
            assert not well.wait(3.0)
