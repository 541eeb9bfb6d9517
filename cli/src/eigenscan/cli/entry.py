"""The entry point of `eigenscan`: Ctrl-C while it still loads ends it as it does later."""

from __future__ import annotations

import os
import signal


def main() -> None:
    """Runs the command."""
    signal.signal(signal.SIGINT, _end)
    from eigenscan.cli.main import app

    signal.signal(signal.SIGINT, signal.default_int_handler)
    app()


def _end(*_: object) -> None:
    os.write(2, b"eigenscan: ended by Ctrl-C\n")
    os._exit(130)  # an exception in the midst of an import would show where


if __name__ == "__main__":
    main()
