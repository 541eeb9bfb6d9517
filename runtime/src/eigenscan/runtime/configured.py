"""What a Zenoh configuration states, without a session."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import zenoh


def stated(path: Path | None, key: str) -> Any:
    """The value of `key`, such as connect/endpoints, in the configuration at `path`; None without one.

    None also where it cannot be read: whoever opens a session with it reports that.
    """
    if path is None:
        return None
    try:
        return json.loads(zenoh.Config.from_file(str(path)).get_json(key))
    except (zenoh.ZError, ValueError):
        return None
