"""A session that stops to deliver: noticed by what others no longer publish, and the process ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.receive_watchdog import EXIT_DEAF, ReceiveWatchdog

from tests.network import free_port

ADDRESS = ("site", "tracker", "r17")
PATIENCE = 20


@dataclass
class FakeSession:
    """A link over which others are received for as long as `delivers`; what is published arrives at once."""

    delivers: bool = True
    linked: bool = True
    routed: bool = True
    """Whether the link is to a router, which answers queries."""
    subscribers: list[tuple[str, Callable[[Any], None]]] = field(default_factory=list)

    def declare_subscriber(self, key: str, callback: Callable[[Any], None], **_: object) -> None:
        self.subscribers.append((key, callback))

    def liveliness(self) -> FakeSession:
        return self

    def get(self, key: str, handler: Callable[[Any], None], timeout: float) -> None:
        assert timeout < PATIENCE
        handler(SimpleNamespace(ok=SimpleNamespace(key_expr=key), err=None))  # this process's own token
        if self.routed and not self.delivers:
            handler(SimpleNamespace(ok=None, err="Timeout"))

    @property
    def info(self) -> SimpleNamespace:
        return SimpleNamespace(routers_zid=lambda: ["router"] * self.linked, peers_zid=lambda: [])

    def _deliver(self, key: str, kind: object) -> None:
        for selector, callback in self.subscribers:
            if self.delivers and zenoh.KeyExpr(selector).intersects(key):
                callback(SimpleNamespace(key_expr=key, kind=kind))

    def health(self, service: str, instance: str = "r17") -> None:
        self._deliver(f"site/health/{service}/{instance}", zenoh.SampleKind.PUT)

    def token(self, service: str, *, there: bool, instance: str = "r17") -> None:
        kind = zenoh.SampleKind.PUT if there else zenoh.SampleKind.DELETE
        self._deliver(f"site/alive/{service}/{instance}/1", kind)


@pytest.fixture
def session() -> FakeSession:
    return FakeSession()


@pytest.fixture
def receiving(session: FakeSession) -> ReceiveWatchdog:
    """Of a tracker among a router and a projector that have been received."""
    receiving = ReceiveWatchdog(PATIENCE)
    receiving.attach(session, *ADDRESS)  # type: ignore[arg-type]
    for service in ("router", "projector"):
        session.token(service, there=True)
        session.health(service)
    assert not ticks(receiving, session, 1)
    return receiving


def ticks(receiving: ReceiveWatchdog, session: FakeSession, count: int, *speaking: str) -> bool:
    """Whether the last of so many seconds finds it deaf; `speaking` publish their health in each."""
    lost = False
    for _ in range(count):
        for service in speaking:
            session.health(service)
        lost = receiving.is_lost(session)  # type: ignore[arg-type]
    return lost


def test_who_is_given_nothing_any_more_is_deaf_after_its_patience(
    session: FakeSession, receiving: ReceiveWatchdog
) -> None:
    assert not ticks(receiving, session, 100, "router", "projector")
    session.delivers = False
    assert not ticks(receiving, session, PATIENCE - 1, "router", "projector")
    assert ticks(receiving, session, 1, "router", "projector")


def test_one_that_is_received_is_enough(session: FakeSession, receiving: ReceiveWatchdog) -> None:
    assert not ticks(receiving, session, 10 * PATIENCE, "router")


def test_its_own_voice_is_none(session: FakeSession, receiving: ReceiveWatchdog) -> None:
    assert ticks(receiving, session, PATIENCE, "tracker")


def test_others_that_ended_are_not_missed(session: FakeSession, receiving: ReceiveWatchdog) -> None:
    for service in ("router", "projector"):
        session.token(service, there=False)
    assert not ticks(receiving, session, 10 * PATIENCE)


def test_who_was_alone_when_it_became_deaf_learns_it_by_queries(
    session: FakeSession, receiving: ReceiveWatchdog
) -> None:
    """Seed 5: the only neighbour was killed, and came back to a session that no longer received anything."""
    for service in ("router", "projector"):
        session.token(service, there=False)
    assert not ticks(receiving, session, 10 * PATIENCE)
    session.delivers = False
    assert not ticks(receiving, session, PATIENCE // 2)
    assert ticks(receiving, session, PATIENCE, "projector")


def test_one_query_that_times_out_is_not_enough(session: FakeSession, receiving: ReceiveWatchdog) -> None:
    for service in ("router", "projector"):
        session.token(service, there=False)
    for _ in range(10):
        session.delivers = not session.delivers
        assert not ticks(receiving, session, PATIENCE // 2)


def test_a_peer_that_answers_no_query_of_tokens_is_no_sign(
    session: FakeSession, receiving: ReceiveWatchdog
) -> None:
    session.delivers, session.routed = False, False
    for service in ("router", "projector"):
        receiving._see(service, "tracker", there=False)
    assert not ticks(receiving, session, 10 * PATIENCE)


ROUTER = """
import sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"router"')
config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:%s"]' % sys.argv[1])
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
print("up", flush=True)
sys.stdin.read()
"""


def test_a_router_answers_a_query_of_tokens_and_one_that_hangs_does_not() -> None:
    """What the fake stands for."""
    port = free_port()
    command = [sys.executable, "-c", ROUTER, str(port)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as router:
        assert router.stdout is not None
        router.stdout.readline()
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["tcp/127.0.0.1:{port}"]')
        session = zenoh.open(config)
        try:
            assert [reply.err for reply in session.liveliness().get("a/*", timeout=60.0)] == []
            router.send_signal(signal.SIGSTOP)
            os.waitpid(router.pid, os.WUNTRACED)  # until all of its threads have stopped
            replies = list(session.liveliness().get("a/*", timeout=0.5))
            assert [reply.ok for reply in replies] == [None]
        finally:
            router.kill()
            session.close()


def test_others_that_never_spoke_are_not_waited_for(session: FakeSession) -> None:
    receiving = ReceiveWatchdog(PATIENCE)
    receiving.attach(session, *ADDRESS)  # type: ignore[arg-type]
    session.token("projector", there=True)
    session.token("projector", there=True, instance="r18")
    session.health("projector", instance="r18")
    assert not ticks(receiving, session, 10 * PATIENCE)


def test_without_a_link_nothing_is_expected(session: FakeSession, receiving: ReceiveWatchdog) -> None:
    session.linked = False
    assert not ticks(receiving, session, 10 * PATIENCE)
    session.linked = True
    assert not ticks(receiving, session, PATIENCE - 1)
    assert ticks(receiving, session, 1)


def test_a_word_that_comes_late_starts_the_patience_again(
    session: FakeSession, receiving: ReceiveWatchdog
) -> None:
    assert not ticks(receiving, session, PATIENCE - 1)
    assert not ticks(receiving, session, 1, "projector")
    assert not ticks(receiving, session, PATIENCE - 1)


def test_two_sessions_of_real_zenoh_receive_each_other(buses: Callable[[], Bus], net: Any) -> None:
    """What the fake stands for: tokens and health of another process, not of its own."""
    from eigenscan.schemas.channels import HEALTH
    from eigenscan.schemas.envelope import Envelope
    from eigenscan.schemas.health_pb2 import Health

    own, other, receiving = buses(), buses(), ReceiveWatchdog(2)
    own.announce(net.site, "tracker", "r17")
    own.watch_others(receiving, net.site, "tracker", "r17")
    other.announce(net.site, "projector", "r17")
    spoken = threading.Event()
    address = {"site": net.site, "instance": "r17"}
    for _ in range(600):
        other.publish(Envelope(HEALTH, address | {"service": "projector"}, Health()))
        own.publish(Envelope(HEALTH, address | {"service": "tracker"}, Health()))
        if receiving._alive & receiving._speaking:
            break
        spoken.wait(0.05)
    assert receiving._alive & receiving._speaking == {"projector"}
    assert not own.is_deaf
    own.publish(Envelope(HEALTH, address | {"service": "tracker"}, Health()))
    assert [own.is_deaf for _ in range(3)][-1]  # the other one's token stands, and it publishes nothing


DEAF = """
import sys
from eigenscan.runtime import node
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.router import RouterCore, RouterSettings

asked = []
Bus.is_deaf = property(lambda _: asked.append(1) or len(asked) > 1)
RouterCore.finish = lambda _: print("finished", flush=True) or ()
sys.argv[1:] = ["--site", "s", "--robot", "r"]
node.main(node.Service("tracker", RouterSettings, RouterCore))
"""


def test_a_deaf_process_ends_in_good_order_with_a_code_of_its_own() -> None:
    done = subprocess.run(
        [sys.executable, "-c", DEAF], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == EXIT_DEAF == 75, done.stderr
    assert "deaf" in done.stdout + done.stderr
    assert '"unfinished": false' in done.stderr
    assert "finished" in done.stdout  # a recorder closes its file
