"""Ports and links for tests that count: on a busy machine neither may be lost to somebody else."""

import itertools
import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eigenscan.runtime.session import URGENT_BATCHES

LOWEST = 12_000
_EPHEMERAL = Path("/proc/sys/net/ipv4/ip_local_port_range")

PATIENT_QUEUE: dict[str, Any] = {
    "size": {"real_time": URGENT_BATCHES, "interactive_high": URGENT_BATCHES},
    "congestion_control": {"drop": {"wait_before_drop": 10_000_000}},
}
"""us before a message is dropped: no link is bad here, only the other end may wait for a processor."""


def patient(config: str) -> str:
    """A configuration, JSON, whose links lose nothing: a busy machine must not lose what the test counts."""
    reported = json.loads(config)
    reported.setdefault("transport", {}).setdefault("link", {})["tx"] = {"queue": PATIENT_QUEUE}
    return json.dumps(reported)


def _ports() -> Iterator[int]:
    """Those below the ones that the kernel gives to who asks for any; each process begins elsewhere."""
    end = int(_EPHEMERAL.read_text().split()[0]) if _EPHEMERAL.exists() else 32_768
    ports = range(LOWEST, max(end, LOWEST + 10_000))
    first = os.getpid() * 97 % len(ports)
    return itertools.cycle([*ports[first:], *ports[:first]])


_NEXT = _ports()


def free_port() -> int:
    """A TCP port of 127.0.0.1 that stays free until it is listened on: nobody else is given it meanwhile."""
    for port in _NEXT:
        try:
            with socket.create_server(("127.0.0.1", port)):
                return port
        except OSError:  # in use
            continue
    raise AssertionError("unreachable")
