"""A signal ends the sleep, wherever in the process it comes in."""

import signal
import threading
import time

import pytest
from eigenscan.runtime.stop_event import StopEvent


def test_a_signal_that_another_thread_takes_ends_the_sleep() -> None:
    """As does one that comes just before the sleep: neither interrupts it."""
    stop = StopEvent()

    def take_it() -> None:
        time.sleep(0.2)
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

    with stop.on_signals():
        thread = threading.Thread(target=take_it)
        thread.start()
        before = time.monotonic()
        stop.wait(60.0)
        assert time.monotonic() - before < 30.0
        thread.join()
    assert stop.stopping
    stop.close()


@pytest.mark.parametrize("before", [signal.SIG_DFL, signal.SIG_IGN])
def test_a_closed_terminal_ends_what_nohup_does_not_keep(before: signal.Handlers) -> None:
    """SIGHUP killed a recorder at once, and its file was torn."""
    usual = signal.signal(signal.SIGHUP, before)
    stop = StopEvent()
    try:
        with stop.on_signals():
            signal.raise_signal(signal.SIGHUP)
        assert stop.stopping is (before is signal.SIG_DFL)
    finally:
        signal.signal(signal.SIGHUP, usual)
        stop.close()
