"""What holds for all tests."""

import signal


def pytest_configure() -> None:
    """Ctrl-C works in the programs under test, also where the tests run in a shell's background.

    Such a shell has it ignored, and children inherit that.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
