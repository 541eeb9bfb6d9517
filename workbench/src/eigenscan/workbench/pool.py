"""A pool of processes that an error, Ctrl-C or another signal ends at once."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import active_children, get_context
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def _signals_later() -> Iterator[None]:
    """Handles signals afterwards: half a process would wait for its other half, and hold the pipes of all.

    Processes that begin meanwhile never receive Ctrl-C.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    # another thread may receive it nevertheless
    usual = {each: signal.signal(each, lambda number, _: came.append(number)) for each in SIGNALS}
    try:
        yield
    finally:
        for each, handler in usual.items():
            signal.signal(each, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        for number in came:
            signal.raise_signal(number)


class Pool(ProcessPoolExecutor):
    """`jobs` new processes, each of which calls `begin` first. Use it with `with`."""

    def __init__(
        self, jobs: int, begin: Callable[..., object] | None = None, given: tuple[Any, ...] = ()
    ) -> None:
        super().__init__(jobs, get_context("spawn"), begin, given)

    def submit(self, work: Callable[P, R], /, *given: P.args, **named: P.kwargs) -> Future[R]:
        """As usual; a signal is for the caller alone, who ends the processes that begin here."""
        try:
            with _signals_later():
                return super().submit(work, *given, **named)
        except BaseException:  # perhaps before the caller is in its `with`
            _kill_children()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """After an error the processes would finish their work first, which nobody reads."""
        if kind:
            _kill_children()
        self.shutdown(cancel_futures=True)


def _kill_children() -> None:
    for process in active_children():
        process.kill()
