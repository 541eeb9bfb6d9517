"""A session for a command that people wait for: it opens soon, or says why not."""

from __future__ import annotations

from pathlib import Path

import zenoh
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.session import open_meanwhile

OPEN_S = 5.0
"""A client's configuration may wait for its router for ever; a person does not."""


class NoRouterError(FailedError):
    """No session within OPEN_S."""


def connect(path: Path | None) -> zenoh.Session:
    """Session from a Zenoh configuration. Raises NoRouterError, or ContractError naming the file."""
    try:
        return open_meanwhile(path, "peer").result(OPEN_S)
    except TimeoutError as error:
        raise NoRouterError(
            f"nobody answers within {OPEN_S:.0f} s: start the router, or correct connect.endpoints in {path}"
        ) from error
