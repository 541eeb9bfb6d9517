"""A session for a command that people wait for: it opens soon, or says why not."""

from __future__ import annotations

import threading
from pathlib import Path

import zenoh
from eigenscan.cli.frame import FailedError
from eigenscan.runtime.session import open_session

OPEN_S = 5.0
"""A client's configuration may wait for its router for ever; a person does not."""


class NoRouterError(FailedError):
    """No session within OPEN_S."""


def connect(path: Path | None) -> zenoh.Session:
    """Session from a Zenoh configuration. Raises NoRouterError, or ContractError naming the file."""
    opened: list[zenoh.Session] = []
    failed: list[Exception] = []

    def run() -> None:
        try:
            opened.append(open_session(path))
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=run, name="session", daemon=True)
    thread.start()
    thread.join(OPEN_S)
    if failed:
        raise failed[0]
    if not opened:
        raise NoRouterError(
            f"nobody answers within {OPEN_S:.0f} s: start the router, or correct connect.endpoints in {path}"
        )
    return opened[0]
