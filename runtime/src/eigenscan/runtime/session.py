"""Opens Zenoh sessions, with errors that name the file."""

from __future__ import annotations

import re
from pathlib import Path

import zenoh
from eigenscan.schemas.channels import ContractError

LOG_FILTER = "error,zenoh::net::routing=off"
"""Of Zenoh's own log, where RUST_LOG says nothing else; its routing takes a neighbour's end for an error."""

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
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise ContractError(
            f"{path or f'embedded {mode}'}: no Zenoh session: {_reason(error)}: "
            "check its listen and connect endpoints"
        ) from error


def _reason(error: zenoh.ZError) -> str:
    """The error in one line, without the places in Zenoh's own sources."""
    return " ".join(_RUST_PLACE.sub("", str(error)).split())
