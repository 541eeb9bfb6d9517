"""Queries on {site}/localize to the projector's process, over loopback TCP, while a robot's scans go on."""

from __future__ import annotations

import json
import math
import re
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import zenoh
from eigenscan.geometry.pose import from_message
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HYPOTHESES, LOCALIZE_TEMPLATE, MAP, MODEL, MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.localize_pb2 import LocalizeQuery, LocalizeReply
from eigenscan.schemas.scan_pb2 import RawScan

from tests.docs.code_blocks import blocks
from tests.network import PATIENT_QUEUE, free_port
from tests.services.projector.office import ADDRESS, envelopes, free_poses, scan_at, site
from tests.services.projector.test_one_shot import raw

pytestmark = pytest.mark.slow

PATIENCE_S = 120.0
PERIOD_S, SCANS = 0.2, 25
FLOOD = 30


@dataclass
class Served:
    """A projector process with a model, and a session of the test's own."""

    session: zenoh.Session
    bus: Bus
    name: str
    process: subprocess.Popen[bytes]

    def ask(self, payload: bytes | None, encoding: str | None = None) -> LocalizeReply | str:
        """The answer, or the error in words."""
        key = LOCALIZE_TEMPLATE.format(site=self.name)
        declared = zenoh.Encoding(encoding) if encoding else None
        (reply,) = self.session.get(key, payload=payload, encoding=declared, timeout=PATIENCE_S)
        if reply.err is not None:
            return reply.err.payload.to_string()
        assert reply.ok is not None
        assert str(reply.ok.encoding) == "application/protobuf;eigenscan.LocalizeReply/1"
        return LocalizeReply.FromString(reply.ok.payload.to_bytes())


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    folder, name = tmp_path_factory.mktemp("queries"), f"test-{uuid.uuid4().hex[:12]}"
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    alone = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    (folder / "hub.json5").write_text(json.dumps(alone | {"listen": {"endpoints": [endpoint]}}))
    leaf = alone | {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, "connect": {"endpoints": [endpoint]}}
    (folder / "leaf.json5").write_text(json.dumps(leaf))
    session = open_session(folder / "hub.json5")
    with Bus(session) as bus:
        bus.offer([MAP, MODEL, MODEL_SET], {"site": name})
        for envelope in envelopes(site()):
            bus.publish(Envelope(envelope.channel, {**envelope.address, "site": name}, envelope.message))
        command = [sys.executable, "-c", "from eigenscan.projector.node import main; main()"]
        where = ["--site", name, "--robot", "r", "--zenoh", str(folder / "leaf.json5")]
        where += ["--stop-s", "60"]  # the machine may be busy
        with (folder / "log").open("wb") as log:
            process = subprocess.Popen([*command, *where], stderr=log)
        one = Served(session, bus, name, process)
        try:
            assert bus.wait_for_listener(SCAN.key({**ADDRESS, "site": name}), PATIENCE_S)
            _wait_until_ready(one)
            yield one
        finally:
            process.kill()
            process.wait(PATIENCE_S)


def _wait_until_ready(served: Served) -> None:
    deadline = time.monotonic() + PATIENCE_S
    payload = query(free_poses(1, 1)[0]).SerializeToString()
    while time.monotonic() < deadline:
        replies = list(served.session.get(LOCALIZE_TEMPLATE.format(site=served.name), payload=payload))
        if any(reply.ok is not None for reply in replies):
            return
        time.sleep(0.1)
    pytest.fail("no answer")


def query(pose: np.ndarray) -> LocalizeQuery:
    return LocalizeQuery(scan=raw(scan_at(pose, field_of_view=2 * np.pi)))


def test_an_answer_comes_without_any_robot_and_states_where(served: Served) -> None:
    pose = free_poses(1, 17)[0]
    reply = served.ask(query(pose).SerializeToString(), "application/protobuf;eigenscan.LocalizeQuery/1")
    assert isinstance(reply, LocalizeReply)
    off = from_message(reply.candidates[0].pose) - pose
    assert np.hypot(*off[:2]) < 0.3
    assert reply.candidates[0].probability > 0.9


def test_the_code_of_the_page_prints_where(served: Served, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = [one.code for one in blocks("docs/contract.md") if "LocalizeQuery" in one.code]
    pose = free_poses(1, 17)[0]
    fields = {name.name: value for name, value in query(pose).scan.ListFields()}
    ranges = fields.pop("ranges")
    names = {"session": served.session, "SITE": served.name, "ranges": ranges, "LIDAR": fields}
    exec(code, {**names, "RawScan": RawScan})
    probability, x, y, _ = map(float, capsys.readouterr().out.splitlines()[0].split())
    assert probability > 0.9
    assert np.hypot(*(pose[:2] - (x, y))) < 0.3


@pytest.mark.parametrize(
    ("payload", "encoding", "words"),
    [
        (None, None, "no payload: give an eigenscan.LocalizeQuery"),
        (b"\xff\xff\xff", None, "localize: 3 bytes do not decode"),
        (b"{}", "application/json", "encoding 'application/json'"),
        (b"\0" * 131_073, None, "131073 bytes; at most 131072"),
        (LocalizeQuery(radius=1.0).SerializeToString(), None, "scan.ranges: no beams"),
        (LocalizeQuery(floor="a" * 100).SerializeToString(), None, "scan.ranges: no beams"),
    ],
    ids=["nothing", "no protobuf", "JSON", "too long", "no scan", "no scan but a floor"],
)
def test_bad_input_is_answered_by_an_error_in_words(
    served: Served, payload: bytes | None, encoding: str | None, words: str
) -> None:
    reported = served.ask(payload, encoding)
    assert isinstance(reported, str)
    assert words in reported


def test_a_flood_of_queries_starves_no_scan_of_the_robot(served: Served) -> None:
    """Each scan is answered before the next; queries that would wait too long are refused."""
    address = {**ADDRESS, "site": served.name}
    inbox, stop = Inbox(), threading.Event()
    served.bus.listen([HYPOTHESES], address, inbox)
    payload = query(free_poses(1, 3)[0]).SerializeToString()
    reported: list[LocalizeReply | str] = []

    def flood() -> None:
        while not stop.is_set():
            reported.append(served.ask(payload))
            time.sleep(0.02)

    threads = [threading.Thread(target=flood, daemon=True) for _ in range(FLOOD)]
    for thread in threads:
        thread.start()
    try:
        late = 0
        for number, pose in enumerate(free_poses(SCANS, 9)):
            served.bus.publish(Envelope(SCAN, address, scan_at(pose, time=1 + number)))
            began = time.monotonic()
            arrival = inbox.take(PATIENCE_S)
            assert arrival is not None, "a scan got no answer"
            late += time.monotonic() - began > PERIOD_S
            time.sleep(PERIOD_S)
    finally:
        stop.set()
        for thread in threads:
            thread.join(PATIENCE_S)
    answered = [one for one in reported if isinstance(one, LocalizeReply)]
    refused = [one for one in reported if isinstance(one, str)]
    assert answered
    assert refused
    assert all(one.startswith("busy: ") for one in refused)
    assert late <= math.ceil(0.5 * SCANS)  # a busy machine; without limits FLOOD queries are before each scan


def test_it_ends_while_queries_wait(served: Served) -> None:
    payload = query(free_poses(1, 5)[0]).SerializeToString()
    replies = [
        served.session.get(LOCALIZE_TEMPLATE.format(site=served.name), payload=payload, timeout=PATIENCE_S)
        for _ in range(6)
    ]
    served.process.send_signal(signal.SIGTERM)
    assert served.process.wait(PATIENCE_S) == 0
    for reply in (one for each in replies for one in each):
        # those of the test before may wait still
        assert reply.err is None or re.search("^busy: |stops", reply.err.payload.to_string())
