"""The entry point of `eigenscan`: Ctrl-C while it still loads ends it as it does later."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """Runs the command."""
    usual = signal.getsignal(signal.SIGINT)
    if usual is not signal.SIG_IGN:  # as a shell has it in a script's background
        signal.signal(signal.SIGINT, _end)
    from eigenscan.cli.main import app

    signal.signal(signal.SIGINT, usual)
    app()


def _end(*_: object) -> None:
    os.write(2, b"eigenscan: ended by Ctrl-C\n")
    os._exit(130)  # an exception in the midst of an import would show where


if __name__ == "__main__":
    main()
