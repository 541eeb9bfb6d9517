"""The harness finds each kind of harm, in processes that may die of it."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from eigenscan.runtime.errors import FailedError

from tests.fuzz.harness import MOST_BYTES, MOST_TEXT, Finding, made, supervise
from tests.fuzz.reader import Opened, Reader
from tests.fuzz.readers import READERS

HARMS = {b"fault": "fault", b"large": "large", b"long": "long", b"kill": "crash", b"leave": "crash"}


def _read(data: bytes) -> None:
    if data == b"fault":
        raise ZeroDivisionError
    if data == b"large":
        bytearray(MOST_BYTES + 2**25).find(b"x")
    if data == b"long":
        raise FailedError("x" * (MOST_TEXT + 1))
    if data == b"kill":
        os.kill(os.getpid(), signal.SIGKILL)
    if data == b"leave":
        os._exit(3)
    if data != b"sound":
        raise FailedError("an error that a user reads")


@pytest.mark.filterwarnings("ignore")  # newer Pythons warn of a fork
def test_every_harm_is_found_and_nothing_else() -> None:
    harms = [*HARMS]

    def opened(_folder: Path) -> Opened:
        attacks = {str(one): one for one in harms}
        return Opened(_read, {"sound": b"sound"}, lambda random, _: random.randbytes(4), lambda: attacks)

    *found, end = supervise(Reader("r", opened), -100, 3.0)
    assert [(one.number, one.what) for one in found if isinstance(one, Finding)] == [
        (-2 - place, HARMS[harm]) for place, harm in enumerate(harms)
    ][::-1]
    assert isinstance(end, tuple)
    following, count = end
    assert count == following + 1 + len(harms) > 100


def test_a_number_makes_the_same_input_everywhere() -> None:
    reader = READERS["settings.flag"]
    first, again = (made(reader, reader.open(Path()), 17) for _ in range(2))
    assert first == again
    assert {made(reader, reader.open(Path()), number) for number in range(5)} != {first}
