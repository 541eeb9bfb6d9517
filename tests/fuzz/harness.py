"""Runs inputs and judges: no crash, no fault of ours, and at most a second and 200 MB each.

An input is a number: it gives the same bytes everywhere. Inputs below 0 are the attacks and the seeds.
"""

from __future__ import annotations

import gc
import json
import mmap
import os
import resource
import signal
import struct
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from itertools import count
from pathlib import Path
from random import Random
from typing import IO

from tests.fuzz.reader import Opened, Place, Reader, is_reported

MOST_CPU_S = 1.0
ENOUGH_CPU_S = 5.0
"""After so long an input is ended."""
MOST_BYTES = 200 * 2**20
SLACK_BYTES = 2**24
"""By which the peak may lie above what is used before an input: to reset it takes a millisecond."""
STALL_S = 120.0
"""For so long an input may take on a busy machine; then SIGALRM ends the process."""
PROGRESS = struct.Struct("<qq")
ROOM_BYTES = 3 * 2**30
"""Of address space, beside what is there: an input must not fill the machine's memory."""
MOST_TEXT = 100_000
"""Characters of an error's message."""


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


def judged(
    reader: Reader, opened: Opened, number: int, data: bytes, most_cpu_s: float = MOST_CPU_S
) -> Finding | None:
    """What an input did; None where it was taken, or refused in good order."""
    found = _once(opened, data, most_cpu_s)
    if found and found[0] in ("slow", "large"):  # what is loaded or compiled at first use does not count
        _forget_peak()
        found = _once(opened, data, most_cpu_s)
    return Finding(reader.name, number, *found) if found else None


def _once(opened: Opened, data: bytes, most_cpu_s: float) -> tuple[str, str] | None:
    """What it did this time, and details."""
    before, began = _resident(), time.process_time()
    if _peak() - before > SLACK_BYTES:
        _forget_peak()
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
        return "large", f"{grew / 2**20:.0f} MB for {len(data)} bytes"
    if reported is None and took > most_cpu_s:
        return "slow", f"{took:.1f} s for {len(data)} bytes"
    return reported


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
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _resident() -> int:
    """Memory that this process has, bytes."""
    return int(Path("/proc/self/statm").read_bytes().split()[1]) * resource.getpagesize()


def work(reader: Reader, first: int, cpu_s: float, progress: mmap.mmap, answers: IO[str]) -> None:
    """In a process of its own: inputs from `first` on, for so much processor time.

    `progress` holds the number of the input that was begun last, and how many were. Below 0 it begins with
    the attacks and the seeds.
    """
    with Place(reader) as opened:
        for data in opened.seeds.values():  # what is compiled or imported late does not count
            with suppress(Exception):
                opened.read(data)
        first = max(first, -len(_fixed(opened)) if first < 0 else 0)
        gc.collect()
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + ROOM_BYTES, resource.RLIM_INFINITY))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        until = time.process_time() + cpu_s
        for number in count(first):
            if time.process_time() > until:
                return
            PROGRESS.pack_into(progress, 0, number, PROGRESS.unpack_from(progress)[1] + 1)
            signal.setitimer(signal.ITIMER_REAL, STALL_S)
            finding = judged(reader, opened, number, made(reader, opened, number))
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            if finding is not None:
                print(json.dumps(asdict(finding)), file=answers, flush=True)


def supervise(reader: Reader, first: int, cpu_s: float) -> Iterator[Finding | tuple[int, int]]:
    """Runs inputs from `first` on for so much processor time, in processes that may die.

    Gives findings, and at the end the number of the next input, and how many were run.
    """
    progress = mmap.mmap(-1, PROGRESS.size)
    PROGRESS.pack_into(progress, 0, first - 1, 0)
    while cpu_s > 0.0:
        before = PROGRESS.unpack_from(progress)[0]
        reading, writing = os.pipe()
        child = os.fork()
        if child == 0:
            _work_and_end(reader, before + 1, cpu_s, progress, writing)
        os.close(writing)
        with os.fdopen(reading) as answers:
            for line in answers:
                yield Finding(**json.loads(line))
        _, status, used = os.wait4(child, 0)
        cpu_s -= used.ru_utime + used.ru_stime
        code = os.waitstatus_to_exitcode(status)
        begun = PROGRESS.unpack_from(progress)[0]
        if code == 0:
            break
        how = f"ends by signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"
        yield Finding(reader.name, begun, "crash", how)
        if begun == before:  # it does not even open
            break
    yield PROGRESS.unpack_from(progress)[0] + 1, PROGRESS.unpack_from(progress)[1]


def _work_and_end(reader: Reader, first: int, cpu_s: float, progress: mmap.mmap, writing: int) -> None:
    code = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        for stream in (1, 2):  # what readers print
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream)
        with os.fdopen(writing, "w") as answers:
            work(reader, first, cpu_s, progress, answers)
        code = 0
    finally:
        os._exit(code)
