"""Runs inputs and judges: no crash, no fault of ours, and at most a second and 200 MB each.

An input is a number: it gives the same bytes everywhere. Inputs below 0 are the attacks and the seeds.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import select
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from itertools import count
from pathlib import Path
from random import Random

from tests.fuzz.reader import Opened, Place, Reader, is_reported

MOST_CPU_S = 1.0
ENOUGH_CPU_S = 5.0
"""After so long an input is ended."""
MOST_BYTES = 200 * 2**20
START_S = 120.0
"""Until a process on a busy machine has begun."""
STALL_S = 20.0
"""Without an answer for so long the process is ended, and its input reported."""
ROOM_BYTES = 3 * 2**30
"""Of address space, beside what is there: an input must not fill the machine's memory."""
MOST_TEXT = 100_000
"""Characters of an error's message."""
_PROJECT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Finding:
    """An input that did harm."""

    reader: str
    number: int
    what: str
    """`fault`, `slow`, `large`, `long` or `crash`."""
    detail: str

    @property
    def kind(self) -> str:
        """The same for all inputs that fail in the same way."""
        return f"{self.reader}: {self.what}: {self.detail.partition(': ')[0] if self.what == 'fault' else ''}"


class _TooLongError(BaseException):
    """Raised where nothing takes it for an error of the input."""


def _too_long(_number: int, _frame: object) -> None:
    raise _TooLongError


def numbered(opened: Opened) -> list[tuple[int, str, bytes]]:
    """What every run begins with: -1, -2, ... and a name and bytes of each; seeds first."""
    fixed = [*opened.seeds.items(), *opened.attacks().items()]
    return [(-1 - place, name, data) for place, (name, data) in enumerate(fixed)]


def made(reader: Reader, opened: Opened, number: int) -> bytes:
    """The input of that number."""
    if number < 0:
        return _fixed(opened)[-1 - number][2]
    random = Random(f"{reader.name} {number}")
    names = sorted(opened.seeds)
    return opened.mutate(random, random.choice(names))


@cache
def _fixed(opened: Opened) -> list[tuple[int, str, bytes]]:
    return numbered(opened)


def run(reader: Reader, opened: Opened, numbers: Sequence[int]) -> Iterator[Finding | int]:
    """Judges inputs; gives each one's number once it is done, after what was found."""
    for number in numbers:
        data = made(reader, opened, number)
        finding = judged(reader, opened, number, data)
        if finding is not None:
            yield finding
        yield number


def judged(
    reader: Reader, opened: Opened, number: int, data: bytes, most_cpu_s: float = MOST_CPU_S
) -> Finding | None:
    """What an input did; None where it was taken, or refused in good order."""
    _forget_peak()
    before, began = _peak(), time.process_time()
    reported: tuple[str, str] | None = None
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, ENOUGH_CPU_S)
    try:
        opened.read(data)
    except _TooLongError as error:
        reported = "slow", f"more than {ENOUGH_CPU_S:g} s, in {_innermost(error)}"
    except Exception as error:
        if not is_reported(error):
            reported = "fault", f"{type(error).__name__} in {_innermost(error)}: {str(error)[:200]}"
        elif len(str(error)) > MOST_TEXT:
            reported = "long", f"a message of {len(str(error))} characters"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    took, grew = time.process_time() - began, _peak() - before
    if reported is None and grew > MOST_BYTES:
        reported = "large", f"{grew / 2**20:.0f} MB for {len(data)} bytes"
    if reported is None and took > most_cpu_s:
        reported = "slow", f"{took:.1f} s for {len(data)} bytes"
    return Finding(reader.name, number, *reported) if reported else None


def _innermost(error: BaseException) -> str:
    """The last line of ours that it passed, and where it was raised."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [each for each in frames if "eigenscan" in each.filename]
    last = (own or frames)[-1:] + frames[-1:]
    return " <- ".join(dict.fromkeys(f"{Path(each.filename).name}:{each.lineno}" for each in last))


def _forget_peak() -> None:
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def _peak() -> int:
    """Most memory that this process had since `_forget_peak`, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def work(reader: Reader, first: int) -> None:
    """In a process of its own: without end, a line of JSON for each finding, and one for each input begun.

    Below 0 it begins with the attacks and the seeds.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what readers print
    with Place(reader) as opened:
        for data in opened.seeds.values():  # what is compiled or imported late does not count
            with suppress(Exception):
                opened.read(data)
        first = max(first, -len(_fixed(opened)) if first < 0 else 0)
        gc.collect()
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
        resource.setrlimit(resource.RLIMIT_AS, (used + ROOM_BYTES, resource.RLIM_INFINITY))
        for number in count(first):
            print(json.dumps(number), file=answers, flush=True)
            for answer in run(reader, opened, [number]):
                if isinstance(answer, Finding):
                    print(json.dumps(asdict(answer)), file=answers, flush=True)


def supervise(reader: Reader, first: int, until: float) -> Iterator[Finding | int]:
    """Runs inputs from `first` on in processes that may die, until the time (time.monotonic()) is over.

    Gives findings, and each input's number once it is begun.
    """
    at = first
    while time.monotonic() < until:
        command = [sys.executable, "-W", "ignore", "-m", "tests.fuzz", "--work", reader.name, str(at)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, cwd=_PROJECT, env=_quiet()
        ) as child:
            try:
                for answer in _answers(reader, child, at, until):
                    if isinstance(answer, int):
                        at = answer + 1
                    yield answer
            finally:
                child.kill()


def _answers(
    reader: Reader, child: subprocess.Popen[bytes], at: int, until: float
) -> Iterator[Finding | int]:
    """What one process reports, until it dies or the time is over."""
    assert child.stdout is not None
    pending, begun, received_at = b"", None, time.monotonic() + START_S
    while (now := time.monotonic()) < until:
        if not select.select([child.stdout], [], [], 1.0)[0]:
            if now - received_at > STALL_S:
                yield Finding(
                    reader.name, at if begun is None else begun, "crash", f"no answer for {STALL_S:g} s"
                )
                return
            continue
        received_at = now
        piece = os.read(child.stdout.fileno(), 65536)
        if not piece:
            code = child.wait()
            where = at if begun is None else begun
            yield Finding(
                reader.name, where, "crash", f"ends by signal {-code}" if code < 0 else f"exit code {code}"
            )
            if begun is None:
                yield at
            return
        *lines, pending = (pending + piece).split(b"\n")
        for line in lines:
            if line.startswith(b"{"):
                yield Finding(**json.loads(line))
            else:
                begun = int(line)
                yield begun


def _quiet() -> dict[str, str]:
    return {
        **os.environ,
        "PYTHONWARNINGS": "ignore",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "NUMBA_NUM_THREADS": "1",
    }
