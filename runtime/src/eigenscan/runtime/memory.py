"""Gives back memory that a process needs only while it starts.

LLVM links compiled code when that is first called. 70 MB of its own library then stay mapped, of which
nothing is used any more; if more is linked later, the system maps them again from its file cache.
"""

from __future__ import annotations

import ctypes
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from pathlib import Path

LINKER, ITS_MODULE = "libllvmlite", "llvmlite"
FIRST_S, EVERY_S = 15.0, 60.0
"""After the start, and from then on: a robot may come later, and more code is linked for its first scan."""
_MADV_DONTNEED = 4
_MAPPINGS = Path("/proc/self/smaps")


class StartMemory:
    """Call `tend` now and then."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._due = clock() + FIRST_S if sys.platform == "linux" else float("inf")
        self._clock, self._is_first = clock, True
        self._parts: list[tuple[int, int]] = []
        """Addresses of the linker's; what nobody can write to stays as it is in the file."""

    def tend(self) -> None:
        """Gives memory back if it is time for it."""
        if self._clock() < self._due:
            return
        self._due = self._clock() + EVERY_S
        libc = ctypes.CDLL(None)
        if self._is_first and hasattr(libc, "malloc_trim"):
            libc.malloc_trim(0)
        self._is_first = False
        if ITS_MODULE not in sys.modules:
            return
        if not self._parts:  # once: to list all that is mapped takes 40 ms
            with (
                suppress(OSError),  # some kernels and containers have no such list
                _MAPPINGS.open(encoding="utf-8", errors="replace") as lines,
            ):
                self._parts = [*unchanged_parts(LINKER, lines)]
        for start, end in self._parts:
            libc.madvise(ctypes.c_void_p(start), ctypes.c_size_t(end - start), _MADV_DONTNEED)


def unchanged_parts(library: str, lines: Iterable[str]) -> Iterator[tuple[int, int]]:
    """Address ranges of a library that nobody can write to or ever wrote to: the file has all of them.

    `lines`: those of /proc/self/smaps.
    """
    found: tuple[int, int] | None = None
    for line in lines:
        name, *rest = line.split()
        if not name.endswith(":"):  # addresses, rights, place in the file, device, file
            start, _, end = name.partition("-")
            is_part = len(rest) == 5 and Path(rest[4]).name.startswith(library) and "w" not in rest[0]
            found = (int(start, 16), int(end, 16)) if is_part else None
        elif name == "Anonymous:" and found and rest[0] == "0":
            yield found
