"""A signal ends the sleep, wherever in the process it comes in."""

import os
import signal
import subprocess
import sys
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


WRITES_ON = """
import signal, sys
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
from eigenscan.runtime.stop_event import StopEvent
stop = StopEvent()
with stop.on_signals():
    print("ready", flush=True)
    while not stop.stopping:
        stop.wait(60.0)
    print("ended", flush=True)
sys.exit(stop.number)
"""


def test_who_writes_to_a_terminal_that_was_closed_goes_on() -> None:
    """`run` ended with an input/output error before it had ended its services."""
    ours, terminal = os.openpty()
    command = [sys.executable, "-c", WRITES_ON]
    with subprocess.Popen(command, stdout=terminal, stderr=subprocess.PIPE, text=True) as process:
        os.close(terminal)
        with os.fdopen(ours, "rb", buffering=0) as terminal_end:
            assert terminal_end.readline().startswith(b"ready")
        process.send_signal(signal.SIGHUP)
        assert process.communicate(timeout=60)[1] == ""
    assert process.returncode == signal.SIGHUP
