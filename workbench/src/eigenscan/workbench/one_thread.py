"""Linear algebra on one thread: speeds are per core, and sums have one order."""

from __future__ import annotations

import os

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")


def one_thread() -> None:
    """Limits numeric libraries to one thread. Call it before numpy is imported."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
