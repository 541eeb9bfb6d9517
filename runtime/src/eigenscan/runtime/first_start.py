"""A service's first start on a machine: numba compiles, the log says so, and the process starts again.

Compiling takes the tracker a minute and leaves it with 400 MB of the compiler's memory. A process that starts
with what is compiled has none of it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

STARTED_AGAIN = "EIGENSCAN_STARTED_AGAIN"
"""Environment variable: a process starts again once, even if nothing compiled could be kept."""
HINT = "the first start on a machine takes a minute or more"


@contextmanager
def compiling(log: Callable[[], object]) -> Iterator[list[str]]:
    """Gives a list that gets each function that numba compiles meanwhile; `log` is called at the first one.

    Only for a process that imports numba anyway.
    """
    from numba.core import event

    compiled: list[str] = []

    class Compiling(event.Listener):
        def on_start(self, event: Any) -> None:
            if not compiled:
                log()
            compiled.append(str(event.data.get("dispatcher")))

        def on_end(self, event: Any) -> None:
            pass

    listener = Compiling()
    event.register("numba:compile", listener)
    try:
        yield compiled
    finally:
        event.unregister("numba:compile", listener)


def start_again() -> None:
    """This process begins anew, with the same command and process id; returns if it did so before."""
    if STARTED_AGAIN in os.environ:
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | {STARTED_AGAIN: "1"})
