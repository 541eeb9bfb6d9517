"""A Zenoh network of one machine: no multicast, loopback only, so that two demos never mix."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import zenoh
from eigenscan.runtime.session import URGENT_BATCHES, open_session
from eigenscan.schemas.channels import ContractError

ATTEMPTS = 5
WAIT_US = 20_000
PATIENT_QUEUE = {
    "size": {"real_time": URGENT_BATCHES, "interactive_high": URGENT_BATCHES},
    "congestion_control": {"drop": {"wait_before_drop": WAIT_US}},
}
"""us before a message is dropped, by default 1,000: on one machine a link never hangs, it is only busy."""


def free_port() -> int:
    """A free TCP port of 127.0.0.1."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def open_hub(folder: Path, patience: float = 1.0) -> tuple[zenoh.Session, Path]:
    """Opens this process's session; returns it with the configuration for other processes.

    Both configurations are written to `folder`. `patience`: factor on PATIENT_QUEUE, the wait before a
    message is dropped. Raises ContractError if no session opens.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for attempt in range(ATTEMPTS):
        address = f"tcp/127.0.0.1:{free_port()}"
        hub = _write(folder / "zenoh-hub.json5", address, [], patience)
        others = _write(folder / "zenoh.json5", "tcp/127.0.0.1:0", [address], patience)
        try:
            return open_session(hub), others
        except ContractError:
            # another process may have taken the port meanwhile
            if attempt == ATTEMPTS - 1:
                raise
    raise AssertionError("unreachable")


def _write(path: Path, listen: str, connect: list[str], patience: float) -> Path:
    drop = {"drop": {"wait_before_drop": round(WAIT_US * patience)}}
    config = {
        "mode": "peer",
        "listen": {"endpoints": [listen]},
        "connect": {"endpoints": connect},
        # the hub's clients find each other by gossip
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
        "transport": {"link": {"tx": {"queue": PATIENT_QUEUE | {"congestion_control": drop}}}},
    }
    path.write_text(json.dumps(config, indent=2) + "\n", encoding="utf-8")
    return path
