"""Opens Zenoh sessions, with errors that name the file."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.schemas.channels import ContractError

LOG_FILTER = "error,zenoh::net::routing=off,zenoh_transport::unicast::establishment=off"
"""Of Zenoh's own log, where RUST_LOG says nothing else; its routing takes a neighbour's end for an error, and
the process that listens on MEETING takes its own attempt to connect there for one."""

MEETING = "tcp/127.0.0.1:7448"
"""Where processes of one machine without a configuration meet. Not Zenoh's own 7447: on a robot with ROS 2
the rmw_zenoh router listens there, on all interfaces, and would let the network in."""

URGENT_BATCHES = 16
"""Zenoh's own 2 are full, and urgent messages dropped, whenever its thread gets no turn for two scans.

A deeper queue makes nobody wait; a longer wait before a drop would, on a link that hangs.
"""
_QUEUE_SIZE = "transport/link/tx/queue/size"

_RUST_PLACE = re.compile(r"\s+at \S+\.rs:\d+\.?")


def open_session(path: Path | None, mode: str = "peer", listen: Sequence[str] = ()) -> zenoh.Session:
    """Session from a JSON5 file; without one a session in `mode` ("peer", "router") for this machine alone.

    `listen`: endpoints where that one may be reached from elsewhere too. Raises ContractError naming the
    file where it is no Zenoh configuration or no session opens.
    """
    zenoh.init_log_from_env_or(LOG_FILTER)
    try:
        config = zenoh.Config.from_file(str(path)) if path else _this_machine(mode, listen)
    except zenoh.ZError as error:
        raise ContractError(f"{path}: is no Zenoh configuration: {_reason(error)}") from error
    _deepen_urgent_queues(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise ContractError(
            f"{path or f'{mode} of this machine'}: no Zenoh session: {_reason(error)}: "
            "check its listen and connect endpoints"
        ) from error


def _this_machine(mode: str, listen: Sequence[str]) -> zenoh.Config:
    """Loopback only, no multicast: nobody else on the network can join.

    The first peer listens on MEETING and the others connect to it, and by gossip to each other. When it ends
    the others stay connected, and the next one that starts takes its place.
    """
    endpoints = [MEETING, *listen] if mode == "router" else [MEETING, "tcp/127.0.0.1:0", *listen]
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": endpoints,
        "scouting/multicast/enabled": False,
    }
    if mode != "router":
        settings |= {
            "listen/exit_on_failure": False,
            "listen/timeout_ms": 0,
            "connect/endpoints": [MEETING],
            "connect/exit_on_failure": False,
            "connect/timeout_ms": 0,
        }
    config = zenoh.Config()
    for name, value in settings.items():
        config.insert_json5(name, json.dumps(value))
    return config


def open_meanwhile(path: Path | None, mode: str) -> Future[zenoh.Session]:
    """A session that opens on a thread of its own: neighbours are looked for during half a second."""
    opening: Future[zenoh.Session] = Future()

    def run() -> None:
        try:
            opening.set_result(open_session(path, mode))
        except BaseException as error:
            opening.set_exception(error)

    threading.Thread(target=run, name="session", daemon=True).start()
    return opening


def _deepen_urgent_queues(config: zenoh.Config) -> None:
    """Unless the user's file has other sizes than Zenoh's own."""
    if json.loads(config.get_json(_QUEUE_SIZE)) == json.loads(zenoh.Config().get_json(_QUEUE_SIZE)):
        for priority in ("real_time", "interactive_high"):
            config.insert_json5(f"{_QUEUE_SIZE}/{priority}", str(URGENT_BATCHES))


def _reason(error: zenoh.ZError) -> str:
    """The error in one line, without the places in Zenoh's own sources."""
    return " ".join(_RUST_PLACE.sub("", str(error)).split())
