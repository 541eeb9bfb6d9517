"""A signal ends the sleep, wherever in the process it comes in."""

import signal
import threading
import time

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
