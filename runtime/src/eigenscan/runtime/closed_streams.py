"""Standard streams that were closed before the process began."""

from __future__ import annotations

import os
import sys
from pathlib import Path

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
