import json
import os
import time
from pathlib import Path
from uuid import uuid4

import psutil
import pytest
import zenoh
from eigenscan.runtime.session import ONE_RECEIVER, URGENT_BATCHES, open_session
from eigenscan.schemas.channels import ContractError

from tests.runtime.conftest import PATIENCE_S

SIZES = "transport/link/tx/queue/size"


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, int]]:
    """The queue sizes of each session that is opened."""
    sizes: list[dict[str, int]] = []
    really_open = zenoh.open

    def spy(config: zenoh.Config) -> zenoh.Session:
        sizes.append(json.loads(config.get_json(SIZES)))
        return really_open(config)

    monkeypatch.setattr(zenoh, "open", spy)
    return sizes


def test_urgent_messages_find_room_unless_the_file_shows_otherwise(
    opened: list[dict[str, int]], tmp_path: Path
) -> None:
    alone = {"mode": "peer", "scouting": {"multicast": {"enabled": False}}}
    plain, own = tmp_path / "plain.json5", tmp_path / "own.json5"
    plain.write_text(json.dumps(alone))
    own.write_text(json.dumps(alone | {"transport": {"link": {"tx": {"queue": {"size": {"real_time": 4}}}}}}))
    for path in (plain, own):
        open_session(path).close()
    assert [sizes["real_time"] for sizes in opened] == [URGENT_BATCHES, 4]
    assert opened[0]["interactive_high"] == URGENT_BATCHES
    assert opened[1]["interactive_high"] < URGENT_BATCHES
    assert opened[0]["data"] == opened[1]["data"]


@pytest.mark.parametrize("content", ["[]", "null", '"peer"', "// {\n[]", "/* { */ 7", ""])
def test_a_file_that_is_no_object_is_refused(tmp_path: Path, content: str) -> None:
    """Zenoh would take some of them for its own defaults, which find every neighbour."""
    path = tmp_path / "zenoh.json5"
    path.write_text(content)
    with pytest.raises(ContractError, match=r"zenoh\.json5: is no Zenoh configuration"):
        open_session(path)


def test_a_file_may_begin_with_comments(tmp_path: Path) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text("// robots [r1]\n/* of\n a site */ { scouting: { multicast: { enabled: false } } }")
    session = open_session(path)
    try:
        assert not session.is_closed()
    finally:
        session.close()


def test_without_a_file_nobody_else_can_join() -> None:
    before = {*psutil.Process().net_connections("inet")}
    session = open_session(None)
    try:
        opened = [one for one in psutil.Process().net_connections("inet") if one not in before]
    finally:
        session.close()
    assert opened
    assert {one.laddr.ip for one in opened} == {"127.0.0.1"}


def test_those_without_a_file_meet_and_still_do_when_the_first_is_gone() -> None:
    key, received = f"test-{uuid4().hex}/word", list[bytes]()
    first, second = open_session(None), open_session(None)
    first.close()
    third = open_session(None)
    second.declare_subscriber(key, lambda sample: received.append(sample.payload.to_bytes()))
    deadline = time.monotonic() + PATIENCE_S
    while not received:
        assert time.monotonic() < deadline
        third.put(key, b"here")
        time.sleep(0.05)
    second.close()
    third.close()


@pytest.mark.parametrize(("mode", "own"), [("peer", True), ("client", True), ("router", False)])
def test_one_thread_receives_but_in_a_router(monkeypatch: pytest.MonkeyPatch, mode: str, own: bool) -> None:
    name, value = ONE_RECEIVER
    monkeypatch.setattr(zenoh, "open", lambda _config: os.environ.get(name))
    monkeypatch.setenv(name, "")
    monkeypatch.delenv(name)
    reported: object = open_session(None, mode)
    assert reported == (value if own else None)
    monkeypatch.setenv(name, "(rx: (worker_threads: 4))")  # who set it knows better
    reported = open_session(None, mode)
    assert reported == "(rx: (worker_threads: 4))"


@pytest.mark.parametrize("own", [None, {"mode": "init"}])
def test_shared_memory_is_off_unless_the_file_sets_it_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, own: dict[str, str] | None
) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text(json.dumps({"mode": "peer", "transport": {"shared_memory": own}} if own else {}))
    monkeypatch.setattr(zenoh, "open", lambda config: config.get_json("transport/shared_memory/enabled"))
    opened: object = open_session(file)
    assert opened == ("true" if own else "false")


def test_a_certificate_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "operator.json5"
    tls = {"connect_private_key": str(tmp_path / "key.pem")}
    path.write_text(json.dumps({"mode": "client", "transport": {"link": {"tls": tls}}}))
    with pytest.raises(
        ContractError, match=r"operator\.json5: connect_private_key = .*key\.pem.*No such file"
    ):
        open_session(path)
