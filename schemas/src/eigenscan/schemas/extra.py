"""Imports of a distribution's extra, with an error that names the extra."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def needs(extra: str, error: type[BaseException] = ImportError) -> Iterator[None]:
    """Use around imports. If one fails, raises `error` that names the extra.

    The name is such as `eigenscan-tracker[node]`. With SystemExit a program ends with that line.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        raise error(f"{missing.name} is not installed: pip install '{extra}'") from missing
