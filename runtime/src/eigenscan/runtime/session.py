"""Opens Zenoh sessions, with errors that name the file."""

from __future__ import annotations

import json
import re
import threading
from concurrent.futures import Future
from pathlib import Path

import zenoh
from eigenscan.schemas.channels import ContractError

LOG_FILTER = "error,zenoh::net::routing=off"
"""Of Zenoh's own log, where RUST_LOG says nothing else; its routing takes a neighbour's end for an error."""

URGENT_BATCHES = 16
"""Zenoh's own 2 are full, and urgent messages dropped, whenever its thread gets no turn for two scans.

A deeper queue makes nobody wait; a longer wait before a drop would, on a link that hangs.
"""
_QUEUE_SIZE = "transport/link/tx/queue/size"

_RUST_PLACE = re.compile(r"\s+at \S+\.rs:\d+\.?")


def open_session(path: Path | None, mode: str = "peer") -> zenoh.Session:
    """Session from a JSON5 file, or without one an embedded session in `mode` ("peer", "router").

    An embedded peer finds its neighbours by multicast. Raises ContractError naming the file where it
    is no Zenoh configuration or no session opens.
    """
    zenoh.init_log_from_env_or(LOG_FILTER)
    try:
        if path:
            config = zenoh.Config.from_file(str(path))
        else:
            config = zenoh.Config()
            config.insert_json5("mode", f'"{mode}"')
    except zenoh.ZError as error:
        raise ContractError(f"{path}: is no Zenoh configuration: {_reason(error)}") from error
    _deepen_urgent_queues(config)
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise ContractError(
            f"{path or f'embedded {mode}'}: no Zenoh session: {_reason(error)}: "
            "check its listen and connect endpoints"
        ) from error


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
