"""What is judged: one reader, inputs that it takes, and the errors in which it may end."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path
from random import Random

from eigenscan.runtime.errors import FailedError, by_users
from eigenscan.schemas.channels import ContractError

Read = Callable[[bytes], object]
"""Reads one input. What it raises must be an error that names the fault of the input."""


@dataclass(frozen=True, eq=False)
class Opened:
    """A reader at work. `seeds`: sound inputs, by name. `attacks`: makes inputs that do harm if they can."""

    read: Read
    seeds: Mapping[str, bytes]
    mutate: Callable[[Random, str], bytes]
    attacks: Callable[[], Mapping[str, bytes]]


@dataclass(frozen=True)
class Reader:
    """`open` prepares it in an empty folder; what it gives is used by one process, from then on."""

    name: str
    open: Callable[[Path], Opened]
    weight: float = 1.0
    """Of the inputs of a run; slow readers get fewer."""


def is_reported(error: BaseException) -> bool:
    """Whether the commands and services show `error` in one line as one of the input."""
    return isinstance(error, ContractError | FailedError) or (
        isinstance(error, Exception) and by_users(error)
    )


class Place(AbstractContextManager["Opened"]):
    """A reader opened in a folder that goes with it."""

    def __init__(self, reader: Reader) -> None:
        self._reader, self._stack = reader, ExitStack()

    def __enter__(self) -> Opened:
        folder = self._stack.enter_context(
            tempfile.TemporaryDirectory(prefix="fuzz.", ignore_cleanup_errors=True)
        )
        return self._reader.open(Path(folder))

    def __exit__(self, *_: object) -> None:
        self._stack.close()
