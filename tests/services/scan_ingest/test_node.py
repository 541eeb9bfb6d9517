"""The service as a process, over loopback TCP, against its core."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import SCAN, SCAN_MOTION, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.wire import encode

from tests.network import PATIENT_QUEUE, free_port

PATIENCE_S = 120.0
SITE = f"test-{uuid.uuid4().hex[:12]}"
FLAGS = ["--angle-step", "0.5", "--range-max", "20", "--mounts", '{"front": {"x": 0.2, "upside_down": true}}']


@pytest.fixture
def hub(tmp_path: Path) -> Iterator[tuple[Bus, Path]]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    alone = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE}}},
    }
    (tmp_path / "hub.json5").write_text(json.dumps(alone | {"listen": {"endpoints": [endpoint]}}))
    leaf = alone | {"listen": {"endpoints": ["tcp/127.0.0.1:0"]}, "connect": {"endpoints": [endpoint]}}
    (tmp_path / "leaf.json5").write_text(json.dumps(leaf))
    with Bus(open_session(tmp_path / "hub.json5")) as bus:
        yield bus, tmp_path / "leaf.json5"


def raw_scans() -> list[Envelope]:
    rng = np.random.default_rng(3)
    address = {"site": SITE, "robot": "r1", "lidar": "front"}
    scans = []
    for number in range(20):
        message = RawScan(
            # every fifth comes twice
            timestamp=stamp((number - (number % 5 == 4)) * 100_000_000 + 1),
            angle_min=-1.5,
            angle_increment=0.01,
            range_max=30.0,
            ranges=rng.uniform(0.0, 40.0, 300).tolist(),
        )
        scans.append(Envelope(SCAN_RAW, address, message))
    return scans


def test_the_process_publishes_what_the_core_publishes(hub: tuple[Bus, Path]) -> None:
    bus, leaf = hub
    received = raw_scans()
    settings = ScanIngestSettings(
        angle_step=0.5, range_max=20.0, mounts={"front": {"x": 0.2, "upside_down": True}}
    )
    core = ScanIngestCore(settings)
    inbox = Inbox()
    bus.listen([SCAN, SCAN_MOTION], {"site": SITE}, inbox)
    where = ["--site", SITE, "--robot", "*", "--zenoh", str(leaf)]
    command = [sys.executable, "-m", "eigenscan.ingest.node", *where, *FLAGS]
    service = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert bus.wait_for_listener(SCAN_RAW.key(received[0].address), PATIENCE_S)
        answered = 0
        # one at a time: scans in a burst may be dropped
        for envelope in received:
            bus.publish(envelope)
            published = sorted((one.key, encode(one.message)) for one in core.handle(envelope))
            arrived = [inbox.take(timeout=PATIENCE_S) for _ in published]
            assert published == sorted((one.key, one.payload) for one in arrived if one is not None)
            answered += any(SCAN.parse(key) for key, _ in published)
        assert answered == 16
        service.send_signal(signal.SIGTERM)
        assert service.wait(PATIENCE_S) == 0
    finally:
        service.kill()
        service.communicate(timeout=PATIENCE_S)


def test_wrong_settings_end_it_with_one_line() -> None:
    command = [sys.executable, "-m", "eigenscan.ingest.node", "--angle-step", "99"]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    assert ended.returncode == 2
    assert ended.stderr.startswith("eigenscan-scan-ingest: --angle-step = '99': ")
    assert ended.stderr.count("\n") == 1
