"""Opens Zenoh sessions, with errors that name the file."""

from __future__ import annotations

import json
import re
from pathlib import Path

import zenoh
from eigenscan.schemas.channels import ContractError

LOG_FILTER = "error,zenoh::net::routing=off"
"""Of Zenoh's own log, where RUST_LOG says nothing else; its routing takes a neighbour's end for an error."""

PATIENT_QUEUE = {
    "size": {"real_time": 16, "interactive_high": 16},
    "congestion_control": {"drop": {"wait_before_drop": 20_000}},
}
"""By default 2 urgent messages wait 1 ms (here: us) before one is dropped: too little for a busy machine."""

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
            config.insert_json5("transport/link/tx/queue", json.dumps(PATIENT_QUEUE))
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
