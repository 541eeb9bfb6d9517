"""Linear algebra on one thread, as evaluation has it: speeds are per core, and sums have one order."""

from __future__ import annotations

import os

from eigenscan.cli.evaluate import THREADS


def one_thread() -> None:
    """To be called before numpy is imported."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
