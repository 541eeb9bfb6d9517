"""The router as a process, between two sessions that know nothing but its address."""

import json
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from eigenscan.runtime import router
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import MODEL, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import RegionModel
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import decode

from tests.network import PATIENT_QUEUE
from tests.runtime.conftest import PATIENCE_S


@pytest.fixture
def routed(net: Any, tmp_path: Path, start: Callable[..., Any]) -> tuple[Callable[[], Any], Path]:
    """A starter of the router, and a client's configuration."""
    port = json.loads(net.hub.read_text())["listen"]["endpoints"][0]
    hub, client = tmp_path / "router.json5", tmp_path / "client.json5"
    alone = {
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    hub.write_text(json.dumps(alone | {"mode": "router", "listen": {"endpoints": [port]}}))
    client.write_text(
        json.dumps(alone | {"mode": "client", "connect": {"endpoints": [port], "timeout_ms": -1}})
    )
    program = tmp_path / "router.py"
    program.write_text(
        f"import sys; sys.path[:] = {sys.path!r}\nfrom {router.__name__} import main\nmain()\n"
    )

    def starter() -> Any:
        service = start(config=hub, program=program)
        service.log("ready")
        return service

    return starter, client


def _model(net: Any, version: str) -> Envelope:
    return Envelope(MODEL, {"site": net.site, "region": "hall"}, RegionModel(region="hall", version=version))


def _next_version(inbox: Inbox) -> str:
    arrival = inbox.take(PATIENCE_S)
    assert arrival is not None
    return decode(MODEL, arrival.payload, arrival.encoding).version  # type: ignore[attr-defined]


def test_a_model_published_while_the_router_was_away_arrives_after_it(
    net: Any, routed: tuple[Callable[[], Any], Path]
) -> None:
    starter, client = routed
    first = starter()
    holder, subscriber, inbox = Bus(open_session(client)), Bus(open_session(client)), Inbox()
    holder.offer([MODEL], {"site": net.site})
    holder.publish(_model(net, "1"))
    subscriber.listen([MODEL], {"site": net.site}, inbox)
    assert _next_version(inbox) == "1"
    first.process.kill()
    first.process.wait()
    holder.publish(_model(net, "2"))
    starter()
    assert _next_version(inbox) == "2"
    subscriber.close()
    holder.close()


def test_it_ends_with_sessions_on_it(net: Any, routed: tuple[Callable[[], Any], Path]) -> None:
    starter, client = routed
    service = starter()
    speaker, subscriber, inbox = Bus(open_session(client)), Bus(open_session(client)), Inbox()
    subscriber.listen([SCAN], {"site": net.site}, inbox)
    end = time.monotonic() + PATIENCE_S
    while not len(inbox):
        assert time.monotonic() < end
        speaker.publish(Envelope(SCAN, {"site": net.site, "robot": "r", "lidar": "l"}, Scan()))
        time.sleep(0.01)
    service.process.send_signal(signal.SIGTERM)
    assert service.process.wait(PATIENCE_S) == 0
    subscriber.close()
    speaker.close()
