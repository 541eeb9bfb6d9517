"""What an extra of a distribution brings: imported where it is needed, named where it is missing."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(extra: str, error: type[BaseException] = ImportError) -> Iterator[None]:
    """Around imports. Raises `error` naming the extra, such as `eigenscan-tracker[node]`, where one fails.

    With SystemExit a program ends with that one line.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        raise error(f"{missing.name} is not installed: pip install '{extra}'") from missing
