"""A service's first start on a machine: numba compiles, the log says so, and the process starts again.

Compiling takes the tracker a minute and leaves it with 400 MB of the compiler's memory. A process that starts
with what is compiled has none of it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

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


def should_start_again(compiled: list[str]) -> bool:
    """Whether numba compiled, and this process has not started again yet."""
    return bool(compiled) and STARTED_AGAIN not in os.environ


def start_again() -> NoReturn:
    """This process begins anew, with the same command and process id."""
    sys.stdout.flush()
    sys.stderr.flush()
    os.execve(sys.executable, [sys.executable, *sys.orig_argv[1:]], os.environ | {STARTED_AGAIN: "1"})
