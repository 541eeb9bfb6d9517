"""`eigenscan-together`: any of the services in one process.

    eigenscan-together [NAME[,NAME...]] [FLAGS] [-- NAME[,NAME...] [FLAGS]]...

FLAGS are those of each service named before them. Without a name: all that a robot needs.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from itertools import groupby
from typing import Any

from eigenscan.cli.launch.supervision import NODES
from eigenscan.runtime.node import Service
from eigenscan.runtime.settings import SettingsError
from eigenscan.runtime.together import main as run

TOGETHER = "together"
"""Name of the process, among those of other services."""
TOGETHER_MODULE = "eigenscan.cli.launch.together"
BETWEEN = "--"
ON_ROBOT = ("scan-ingest", "projector", "tracker")

Group = tuple[Sequence[str], Sequence[str]]


def main() -> None:
    """Entry point."""
    words = sys.argv[1:]
    if {"-h", "--help"} & {*words}:
        print(__doc__)
        return
    run(lambda: groups(words), service)


def groups(words: Sequence[str]) -> list[Group]:
    """Names and flags, nearest the sensor first. Raises SettingsError for names that are none."""
    found: list[Group] = []
    parts = [list(part) for between, part in groupby(words, lambda word: word == BETWEEN) if not between]
    for part in parts or [[]]:
        named = bool(part) and not part[0].startswith("-")
        names = part[0].split(",") if named else list(ON_ROBOT)
        for name in names:
            if name not in NODES:
                raise SettingsError(f"no service {name!r}; choose one of {', '.join(NODES)}")
        found.append((names, part[1:] if named else part))
    return sorted(found, key=lambda group: min(map([*NODES].index, group[0])))


def service(name: str) -> Service[Any]:
    """The service of that name."""
    found: Service[Any] = importlib.import_module(NODES[name]).SERVICE
    return found


if __name__ == "__main__":
    main()
