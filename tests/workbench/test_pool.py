"""Processes of a pool end with what they work for."""

import os
import signal
import time

import psutil
import pytest
from eigenscan.workbench.pool import SIGNALS, Pool


def _own() -> list[psutil.Process]:
    return [each for each in psutil.Process().children() if "spawn_main" in " ".join(each.cmdline())]


def _signalled(error: type[BaseException]) -> None:
    with Pool(1) as pool:
        pool.submit(int).result()
        assert _own()
        pool.submit(time.sleep, 600.0)
        raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, SystemExit])
def test_a_signal_ends_the_processes_amid_their_work(error: type[BaseException]) -> None:
    """A replay-test that was ended went on until its recordings were through."""
    began = time.monotonic()
    with pytest.raises(error):
        _signalled(error)
    assert not _own()
    assert time.monotonic() - began < 300.0


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_amid_the_start_of_a_process_is_handled_after_it(
    monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    """Ctrl-C was lost there; half a process stayed, with a trace, or for ever."""
    starts: list[bool] = []
    start = Pool._spawn_process  # type: ignore[attr-defined]

    def signalled(self: Pool) -> None:
        os.kill(os.getpid(), number)
        start(self)
        starts.append(True)

    def handle(*_: object) -> None:
        raise InterruptedError

    monkeypatch.setattr(Pool, "_spawn_process", signalled)
    usual = signal.signal(number, handle)
    try:
        with Pool(1) as pool, pytest.raises(InterruptedError):
            pool.submit(int)
    finally:
        signal.signal(number, usual)
    assert starts
    assert not _own()


def test_work_is_finished_otherwise() -> None:
    with Pool(2) as pool:
        slow = pool.submit(time.sleep, 0.2)
    assert slow.done()
    assert not slow.cancelled()
