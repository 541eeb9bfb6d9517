"""A service as a child of this command: `python -m eigenscan.cli.launch.child PARENT MODULE FLAGS…`.

On Linux it receives SIGTERM when its parent ends, even if the parent was killed.
"""

from __future__ import annotations

import importlib
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Runs the service whose node module is the second argument; the first: its parent's process id."""
    parent, module, *flags = sys.argv[1:]
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != int(parent):  # it died before the line above
            sys.exit(1)
    sys.argv = [module, *flags]
    importlib.import_module(module).main()


if __name__ == "__main__":
    main()
