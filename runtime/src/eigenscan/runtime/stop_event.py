"""Stops the main thread's sleep from signal handlers and other threads, without a lock.

`threading.Event.set` in a signal handler deadlocks if the signal comes while the main thread holds
the event's own lock.
"""

from __future__ import annotations

import contextlib
import select
import signal
import socket
import threading
from collections.abc import Iterator
from types import FrameType
from typing import Protocol

from eigenscan.runtime.closed_streams import leave_terminal


class Stopping(Protocol):
    """A flag that ends a service."""

    stopping: bool

    def set(self) -> None:
        """Wakes the main thread."""
        ...


class StopEvent:
    """A flag for "stop", and a sleep that `set` and the first of SIGTERM, SIGINT and SIGHUP end."""

    def __init__(self) -> None:
        self.stopping = False
        self.number: int | None = None
        """Of the signal that requested the end."""
        self._read, self._write = socket.socketpair()
        self._read.setblocking(False)
        self._write.setblocking(False)

    def stop(self) -> None:
        """Requests the end; callable from any thread or signal handler."""
        self.stopping = True
        self.set()

    def set(self) -> None:
        """Ends the present or next `wait`."""
        with contextlib.suppress(BlockingIOError):  # the buffer is full: the thread wakes anyway
            self._write.send(b"\0")

    def wait(self, timeout: float) -> None:
        """Sleeps until `set`, at most `timeout` seconds."""
        if select.select([self._read], [], [], max(timeout, 0.0))[0]:
            with contextlib.suppress(BlockingIOError):
                self._read.recv(4096)

    @contextlib.contextmanager
    def on_signals(self) -> Iterator[None]:
        """Turns SIGTERM, SIGINT and a closed terminal's SIGHUP into `stop`, in the main thread only."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def handler(number: int, _frame: FrameType | None) -> None:
            self.number = number
            if number == signal.SIGHUP:
                leave_terminal()
            self.stop()

        numbers = [signal.SIGTERM, signal.SIGINT]
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # as nohup has it
            numbers.append(signal.SIGHUP)
        before = {number: signal.signal(number, handler) for number in numbers}
        # otherwise a signal just before `select` would be handled only after it
        woken = signal.set_wakeup_fd(self._write.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(woken)
            for number, previous in before.items():
                signal.signal(number, previous)

    def close(self) -> None:
        """Frees the sockets."""
        self._read.close()
        self._write.close()
