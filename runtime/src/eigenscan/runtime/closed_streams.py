"""Standard streams that were closed: before the process began, or with the terminal."""

from __future__ import annotations

import os
import sys
from pathlib import Path

STDOUT = 1
STDERR = 2
"""The last of the three numbers."""


def lead_nowhere() -> None:
    """Lets closed streams lead to the null device, where Python has None.

    Else the next file that is opened takes the number, and gets what libraries write there.
    """
    nowhere = Path(os.devnull)
    while (number := os.open(nowhere, os.O_RDWR)) <= STDERR:
        pass
    os.close(number)
    sys.stdout = sys.stdout or nowhere.open("w", encoding="utf-8")
    sys.stderr = sys.stderr or nowhere.open("w", encoding="utf-8")


def leave_terminal() -> None:
    """Lets streams of a terminal that is gone lead to the null device: each write to it would fail."""
    for number in (STDOUT, STDERR):
        try:
            os.write(number, b"")
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, number)
            os.close(nowhere)
