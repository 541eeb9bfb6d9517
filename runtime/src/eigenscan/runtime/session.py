"""Opens Zenoh sessions, with errors that name the file."""

from __future__ import annotations

import json
import os
import re
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.runtime.certificates import TLS, check_readable
from eigenscan.schemas.channels import ContractError

LOG_FILTER = "error,zenoh::net::routing=off,zenoh_transport::unicast::establishment=off"
"""Zenoh's own log, unless RUST_LOG is set. Off: its routing reports each neighbour that ends as an error, and
the process that listens on MEETING reports its own attempt to connect there as one."""

MEETING = "tcp/127.0.0.1:7448"
"""Address at which the processes of one machine find each other when they have no configuration.

Not Zenoh's default port 7447: on a robot with ROS 2, the rmw_zenoh router listens there, on all interfaces,
and would let the network in."""

URGENT_BATCHES = 16
"""Length of the queues for urgent messages, in batches.

Zenoh's default, 2, is full as soon as its thread gets no turn for two scans, and then it drops messages.
A deeper queue delays nothing. A longer wait before a drop would delay senders on a link that hangs.
"""
ONE_RECEIVER = "ZENOH_RUNTIME", "(rx: (worker_threads: 1))"
"""Zenoh's own 2 wake each other for each message: a tenth of a quiet robot's CPU time. Other threads send: a
receiver that waits for room to send must not wait for itself, for Zenoh then closes the link. A router keeps
both, because one that waits for a slow link must not stop the others."""
_SHARED_MEMORY = "transport/shared_memory"
_QUEUE_SIZE = "transport/link/tx/queue/size"

_OBJECT = re.compile(r"(?:\s|//[^\n]*\n|/\*.*?\*/)*\{", re.DOTALL)
"""How a JSON5 object begins, after comments."""
_RUST_PLACE = re.compile(r"\s+at \S+\.rs:\d+\.?")


class UnreachableError(ContractError):
    """Nobody answers at the addresses of a configuration that does not wait for them."""


def open_session(path: Path | None, mode: str = "peer", listen: Sequence[str] = ()) -> zenoh.Session:
    """Opens a session as the JSON5 file configures it; without a file, one for this machine alone.

    `mode` ("peer", "router") and `listen` (more endpoints, such as tcp/0.0.0.0:7447) apply without a file.
    Raises ContractError that names the file if it is no Zenoh configuration, a certificate that cannot be
    read, or why no session opens; UnreachableError if that is because nobody answers.
    """
    if mode != "router":
        os.environ.setdefault(*ONE_RECEIVER)
    zenoh.init_log_from_env_or(LOG_FILTER)
    if path and not path.exists():
        raise ContractError(f"{path}: no such Zenoh configuration: check --zenoh")
    if path and _is_another_json(path):
        raise ContractError(f"{path}: is no Zenoh configuration (JSON5): it must begin with {{")
    try:
        config = zenoh.Config.from_file(str(path)) if path else _this_machine(mode, listen)
    except zenoh.ZError as error:
        what = f"{path}: is no Zenoh configuration (JSON5)" if path else f"--listen {' '.join(listen)}"
        raise ContractError(f"{what}: {_reason(error)}") from error
    check_readable(path, json.loads(config.get_json(TLS)) or {})
    _deepen_urgent_queues(config)
    _leave_shared_memory(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        reason = _reason(error)
        mend = (
            "another process listens there; where that is the router, give a service's configuration"
            if "already in use" in reason
            else "check its listen and connect endpoints"
        )
        kind = UnreachableError if reason.startswith("Unable to connect") else ContractError
        raise kind(f"{path or f'{mode} of this machine'}: no Zenoh session: {reason}: {mend}") from error


def _is_another_json(path: Path) -> bool:
    """Whether a JSON5 file holds no object: Zenoh takes a list for its own defaults, which find anybody."""
    if path.suffix not in {".json", ".json5"}:
        return False
    return _OBJECT.match(path.read_text(encoding="utf-8", errors="replace")) is None


def _this_machine(mode: str, listen: Sequence[str]) -> zenoh.Config:
    """Configuration for loopback only, without multicast: no other machine can join.

    The first peer listens on MEETING. The others connect to it, and by gossip to each other. When it ends,
    the others stay connected, and the next peer that starts listens there.
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
    """Opens a session on its own thread, because Zenoh looks for neighbours for half a second."""
    opening: Future[zenoh.Session] = Future()

    def run() -> None:
        try:
            opening.set_result(open_session(path, mode))
        except BaseException as error:
            opening.set_exception(error)

    threading.Thread(target=run, name="session", daemon=True).start()
    return opening


def _deepen_urgent_queues(config: zenoh.Config) -> None:
    """Sets URGENT_BATCHES, unless the user's file changes the sizes."""
    if json.loads(config.get_json(_QUEUE_SIZE)) == json.loads(zenoh.Config().get_json(_QUEUE_SIZE)):
        for priority in ("real_time", "interactive_high"):
            config.insert_json5(f"{_QUEUE_SIZE}/{priority}", str(URGENT_BATCHES))


def _leave_shared_memory(config: zenoh.Config) -> None:
    """Turns Zenoh's shared memory off, unless the user's file changes its settings.

    Two threads watch it, and 16 MB are set apart for it; messages of a few kB gain nothing.
    """
    if json.loads(config.get_json(_SHARED_MEMORY)) == json.loads(zenoh.Config().get_json(_SHARED_MEMORY)):
        config.insert_json5(f"{_SHARED_MEMORY}/enabled", "false")


def _reason(error: zenoh.ZError) -> str:
    """The error in one line, without the places in Zenoh's own sources."""
    return " ".join(_RUST_PLACE.sub("", str(error)).split())
