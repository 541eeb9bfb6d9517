"""Archives of numpy (npz) that others may have written."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    KeyError,
    ValueError,
    TypeError,
    IndexError,
    EOFError,
    MemoryError,
    OverflowError,
    RecursionError,
    RuntimeError,  # of zipfile: encrypted
    NotImplementedError,  # of zipfile: another compression
    SyntaxError,  # of numpy's headers
    tokenize.TokenError,  # of the same, where a bracket is not closed
    zipfile.LargeZipFile,
)
"""Errors that a damaged archive may raise, besides OSError."""
MOST_BYTES = 2**26
"""Most bytes of the arrays of an archive; for a large archive MOST_TIMES its own size."""
MOST_TIMES = 20
"""Ranges of a region shrink to a third, at best to a tenth."""


@contextmanager
def opened(path: Path, most_bytes: int = MOST_BYTES) -> Iterator[Any]:
    """The arrays of an archive by name; each is read on access.

    Raises ValueError if they take more than `most_bytes` and more than the archive's size allows, so that a
    few kilobytes cannot fill the memory. Raises OSError, and one of DAMAGE.
    """
    with path.open("rb") as raw:
        with zipfile.ZipFile(raw) as archive:
            unfolded = sum(part.file_size for part in archive.infolist())
        if unfolded > max(most_bytes, MOST_TIMES * raw.seek(0, 2)):
            raise ValueError(f"{unfolded} bytes of arrays: more than a file of this size holds")
        raw.seek(0)
        with np.load(raw, allow_pickle=False) as file:
            yield file
