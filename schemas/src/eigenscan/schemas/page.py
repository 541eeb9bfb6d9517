"""Writes the tables of docs/contract.md from the one table in channels.py.

`python -m eigenscan.schemas.page PAGE [--check]` replaces what stands between `<!-- NAME -->` and
`<!-- /NAME -->`; with `--check` a page that is not current is an error.
"""

from __future__ import annotations

import math
import re
import sys
from importlib.metadata import version
from pathlib import Path

from eigenscan.schemas.channels import (
    ALIVE_TEMPLATE,
    CHANNELS,
    CONTRACT_VERSION,
    LATCHED_TEMPLATE,
    Channel,
    Role,
)
from eigenscan.schemas.foreign import DISTRIBUTION


def tables() -> dict[str, str]:
    """Markdown of each generated part of the page, by its name."""
    return {
        "keys": _table(("key", "message", "what"), [_key(channel) for channel in CHANNELS]),
        "qos": _table(
            (
                "channel",
                "priority",
                "when congested",
                "express",
                "latched",
                "queue a key",
                "usual rate",
            ),
            [_qos(channel) for channel in CHANNELS],
        ),
        "air": _table(
            ("channel", "published by", "received by", "over the air"),
            [_air(channel) for channel in CHANNELS],
        ),
        "tokens": _table(
            ("key", "held by"),
            [
                (f"`{ALIVE_TEMPLATE}`", f"every service instance; `{{contract}}` is {CONTRACT_VERSION}"),
                (f"`{LATCHED_TEMPLATE}`", "every session that answers queries for that latched channel"),
            ],
        ),
        "versions": _table(
            ("what", "version", "where it is had"),
            [
                (
                    "Zenoh",
                    version("eclipse-zenoh"),
                    "Python `eclipse-zenoh`, Rust `zenoh`, C `zenoh-c`, C++ `zenoh-cpp`",
                ),
                ("foxglove's schemas", version(DISTRIBUTION), "`schemas/proto/foxglove`, MIT licence"),
                ("ours", f"contract {CONTRACT_VERSION}", "`schemas/proto/eigenscan/schemas`, Apache-2.0"),
            ],
        ),
    }


def _key(channel: Channel) -> tuple[str, ...]:
    return f"`{channel.template}`", f"`{channel.schema_name}`", channel.about


def _qos(channel: Channel) -> tuple[str, ...]:
    qos = channel.qos
    return (
        f"`{channel.name}`",
        qos.priority.name,
        "block" if qos.block else "drop",
        "yes" if qos.express else "",
        "yes" if qos.latched else "",
        (f"{qos.depth}" if qos.depth else "all") + ("; behind: 1" if qos.newest else ""),
        f"{qos.rate_hz:g} Hz" if qos.rate_hz else "on change",
    )


def _air(channel: Channel) -> tuple[str, ...]:
    hz = channel.qos.air_hz
    limit = f"up to {hz:g} Hz" if math.isfinite(hz) else "all"
    return (
        f"`{channel.name}`",
        ", ".join(role.value for role in channel.published_by),
        "robot, site" if Role.ROBOT in channel.received_by else "site",
        "from the site: all" if channel.to_one_robot else limit if hz else "no",
    )


def _table(head: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def fill(page: str) -> str:
    """`page` with every generated part written again. Raises ValueError where a part's marks are missing."""
    for name, text in tables().items():
        part = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        page, found = part.subn(lambda match, text=text: f"{match[1]}{text}\n{match[2]}", page)  # type: ignore[misc]
        if found != 1:
            raise ValueError(f"the page has no part between <!-- {name} --> and <!-- /{name} -->")
    return page


def main(arguments: list[str]) -> int:
    """Brings the page that `arguments` name up to date; gives the exit code."""
    path = Path(arguments[0])
    before = path.read_text(encoding="utf-8")
    after = fill(before)
    if after != before:
        if "--check" in arguments:
            print(f"{path} is not current: run tools/generate-contract", file=sys.stderr)
            return 1
        path.write_text(after, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
