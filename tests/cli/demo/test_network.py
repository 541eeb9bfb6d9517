"""The demo's network: its processes meet, others stay outside."""

import time
from pathlib import Path

import zenoh
from eigenscan.cli.launch.network import open_hub
from eigenscan.runtime.session import open_session


def _receives(listener: zenoh.Session, speaker: zenoh.Session, seconds: float) -> bool:
    received: list[str] = []
    with listener.declare_subscriber("trial/**", lambda sample: received.append(str(sample.key_expr))):
        deadline = time.monotonic() + seconds
        while not received and time.monotonic() < deadline:
            speaker.put("trial/word", b"")
            time.sleep(0.02)
    return bool(received)


def test_members_meet_each_other_and_strangers_stay_outside(tmp_path: Path) -> None:
    hub, members = open_hub(tmp_path / "a")
    other_hub, other_members = open_hub(tmp_path / "b")
    first, second = open_session(members), open_session(members)
    stranger = open_session(other_members)
    try:
        assert _receives(first, second, 120.0)
        assert _receives(hub, first, 120.0)
        assert _receives(other_hub, stranger, 120.0)
        assert not _receives(first, stranger, 1.0)
        hub.close()
        assert _receives(second, first, 120.0)
    finally:
        for session in (first, second, stranger, hub, other_hub):
            session.close()
