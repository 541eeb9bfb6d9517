"""What ends a command ends all that it started."""

import signal
import subprocess
import sys

import psutil
import pytest

HEEDING = "import signal; signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
"""The tests themselves may run under nohup."""
IGNORING = HEEDING.replace("SIG_DFL", "SIG_IGN")
WITH_A_CHILD = """
import sys, time
from eigenscan.cli import entry, main
from eigenscan.workbench.conformance.candidate import Candidate

def app():
    with Candidate([sys.executable, "-c", "import time; time.sleep(600)"], {}) as candidate:
        print(candidate._process.pid, flush=True)
        time.sleep(600)

main.app = app
entry.main()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_candidate_ends_with_the_command_that_judges_it(number: signal.Signals) -> None:
    """By `timeout` or a closed terminal it was left behind, and ran for ever."""
    program = [sys.executable, "-c", HEEDING + WITH_A_CHILD]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as command:
        assert command.stdout is not None
        child = psutil.Process(int(command.stdout.readline()))
        try:
            command.send_signal(number)
            assert command.wait(60) == -number  # as if it had no handler
            assert not child.is_running() or child.status() == psutil.STATUS_ZOMBIE
        finally:
            command.kill()
            if child.is_running():
                child.kill()


SIGNALLED = """
import os, signal
from eigenscan.cli import entry, main
main.app = lambda: os.kill(os.getpid(), signal.SIGHUP)
entry.main()
"""


@pytest.mark.parametrize(("before", "code"), [(IGNORING, 0), (HEEDING, -signal.SIGHUP)])
def test_nohup_is_heeded(before: str, code: int) -> None:
    assert subprocess.run([sys.executable, "-c", before + SIGNALLED], check=False).returncode == code


SWALLOWED = """
import ctypes, os, signal, time
from eigenscan.cli import entry, main

def app():
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), {number}))()  # as numba's compiler calls back
    time.sleep(600)

main.app = app
entry.main()
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_comes_in_a_callback_of_compiled_code_ends_the_command(number: signal.Signals) -> None:
    """`evaluate` went on for minutes where SIGTERM came as numba compiled."""
    program = HEEDING + SWALLOWED.format(number=int(number))
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (-number, b"")
