"""What holds for all tests."""

import os
import signal

from hypothesis import HealthCheck, settings

from tests.environment import PATIENT

# the same examples in each run, however slow the machine: what fails here fails everywhere
settings.register_profile(
    "suite", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("suite")


def pytest_configure() -> None:
    """Services take their time; and Ctrl-C works, also where the tests run in a shell's background.

    Such a shell has it ignored, and children inherit that.
    """
    os.environ.update(PATIENT)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
