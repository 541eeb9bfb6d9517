"""A process that waits for room to send does not wait for itself."""

import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.schemas.channels import MODEL, SCAN

from tests import environment
from tests.runtime.conftest import PATIENCE_S

SCANS = 40
MODEL_BYTES = 2_000_000
"""Many times what Zenoh's queue of one priority holds, so that each answer waits for room to send."""


def test_what_is_published_in_a_callback_arrives_though_it_waits_for_room(net: Any) -> None:
    """Zenoh on a single thread closed the link here: its thread waited for room that only it could make."""
    session, received, all_here = net.open(net.hub), [], threading.Event()

    def receive(sample: Any) -> None:
        received.append(len(sample.payload.to_bytes()))
        if len(received) == SCANS:
            all_here.set()

    subscriber = session.declare_subscriber(MODEL.selector({"site": net.site}), receive)
    program = Path(__file__).with_name("flooded.py")
    command = [sys.executable, program, net.leaf, net.site, MODEL_BYTES]
    with subprocess.Popen(
        [*map(str, command)], stdout=subprocess.PIPE, text=True, env=environment.clean()
    ) as flooded:
        try:
            assert flooded.stdout
            assert flooded.stdout.readline() == "ready\n"
            key = SCAN.key({"site": net.site, "robot": "r", "lidar": "front"})
            publisher: Any = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK)
            deadline = time.monotonic() + PATIENCE_S
            while not publisher.matching_status.matching:
                assert time.monotonic() < deadline
                time.sleep(0.01)
            for _ in range(SCANS):
                publisher.put(b"")
            all_here.wait(PATIENCE_S)
        finally:
            flooded.kill()
    subscriber.undeclare()
    session.close()
    assert len(received) == SCANS
    assert min(received) > MODEL_BYTES
