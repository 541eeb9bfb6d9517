"""Callbacks in Zenoh's own thread, for what takes microseconds and neither publishes nor queries."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from functools import wraps
from typing import Any

import zenoh

_HELD = threading.local()


def at_once(callback: Callable[[Any], None]) -> Any:
    """A handler for a subscriber. Zenoh would otherwise start a thread for it, and wake that for each sample.

    Python makes a state for each thread that comes from outside, and drops it when that leaves again: two
    system calls, and memory that is given back. So the first call of a thread holds its state.
    """

    @wraps(callback)
    def receive(sample: Any) -> None:
        if not hasattr(_HELD, "state"):
            _HELD.state = ctypes.pythonapi.PyGILState_Ensure()
        callback(sample)

    return zenoh.handlers.Callback(receive, indirect=False)
