"""Fetches a robot's recordings of a period, piece by piece; resumes after a break.

The robot's answers are not trusted: names stay within the folder, sizes within the disk.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import zenoh
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.recording import RecordingError, message_count
from eigenscan.runtime.repair import repair
from eigenscan.schemas.channels import MOST_RECORDED_BYTES, RECORDINGS_TEMPLATE
from eigenscan.schemas.recordings_pb2 import RecordingPart, RecordingParts, RecordingRequest
from google.protobuf.message import DecodeError

PIECE_BYTES = 262_144
"""Size of one answer: a fifth of a second on a link of 10 Mbit/s, so poses do not wait long."""
OVERLAP_BYTES = 4_096
"""Part of the local file that is fetched again before resuming, to notice another file of the same name."""
PARTIAL = ".part"
"""How the name of a file ends that is not here as a whole, or that the robot still writes."""

Ask = Callable[[str, bytes], bytes]
"""Puts a query for `parts` or `bytes` with its payload; gives the answer. Raises FailedError."""
Moved = Callable[[int], object]
"""Receives how many bytes came."""


@dataclass(frozen=True)
class Fetched:
    """A file that is here: `path`; `bytes_moved` of it came now."""

    part: RecordingPart
    path: Path
    bytes_moved: int


def asker(session: zenoh.Session, site: str, robot: str, patience_s: float) -> Ask:
    """Asks the recorder of `robot`, and waits for each answer for `patience_s`."""

    def ask(what: str, payload: bytes) -> bytes:
        replies = session.get(
            RECORDINGS_TEMPLATE.format(site=site, robot=robot, what=what),
            payload=payload,
            timeout=patience_s,
            priority=zenoh.Priority.BACKGROUND,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )
        refused = ""
        for reply in replies:
            if reply.ok is not None:
                answer = reply.ok.payload
                if len(answer) > MOST_RECORDED_BYTES:
                    raise FailedError(f"{robot}: answers with {len(answer)} bytes: do not trust this robot")
                return answer.to_bytes()
            if reply.err is not None:
                refused = reply.err.payload.to_bytes().decode(errors="replace")
        if refused and refused != "Timeout":
            raise FailedError(f"{robot}: {refused}")
        raise FailedError(
            f"{robot} did not answer within {patience_s:g} s: its link is down, or it has no recorder with "
            "mcap, or --zenoh is not the operator's, or its or the site's router has an older configuration "
            "(eigenscan fleet configure)"
        )

    return ask


def parts_within(ask: Ask, robot: str, begin_ns: int, end_ns: int) -> list[RecordingPart]:
    """The robot's files that overlap a period, oldest first.

    Raises FailedError if there is none, with the period that the robot has.
    """
    try:
        found = list(RecordingParts.FromString(ask("parts", b"")).parts)
    except DecodeError as error:
        raise FailedError(f"{robot}: its answer is no eigenscan.RecordingParts: another release?") from error
    for part in found:
        if Path(part.name).name != part.name or part.name.startswith(".") or not part.name.endswith(".mcap"):
            raise FailedError(f"{robot}: {part.name!r} is no name of a recording: do not trust this robot")
    within = [part for part in found if part.begin_ns <= end_ns and part.end_ns >= begin_ns and part.size]
    if not within:
        kept = ""
        if found:
            kept = f": it keeps {utc(found[0].begin_ns)} to {utc(max(part.end_ns for part in found))}"
        raise FailedError(f"{robot} has no recording of that time{kept or ': it keeps none at all'}")
    return within


def missing_bytes(parts: Sequence[RecordingPart], folder: Path) -> int:
    """Bytes that are not here yet. Raises FailedError if the disk has no room for them."""
    missing = sum(max(part.size - _have(folder, part), 0) for part in parts)
    place = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    # a file that is still written is here twice: as it came, and with an index
    free, needed = shutil.disk_usage(place).free, missing + sum(p.size for p in parts if not p.closed)
    if needed > free:
        raise FailedError(
            f"{place}: has {free / 1e6:.0f} MB free for {needed / 1e6:.0f} MB: ask for less time or make room"
        )
    return missing


def fetch(ask: Ask, part: RecordingPart, folder: Path, moved: Moved = lambda _bytes: None) -> Fetched:
    """Fetches one file into `folder`; resumes an interrupted call.

    A closed file becomes identical to the robot's. Of an open file, the part that existed when it was listed
    is kept with the suffix PARTIAL, and beside it as a complete recording with an index. Raises FailedError
    if the robot stops answering, or if the file is no recording.
    """
    target, partial = folder / part.name, folder / (part.name + PARTIAL)
    if part.closed and _have(folder, part) == part.size and not partial.exists():
        return Fetched(part, target, 0)
    folder.mkdir(parents=True, exist_ok=True)
    came = 0
    try:
        with partial.open("a+b") as file:
            at = _resume(ask, part, file.seek(0, 2), partial)
            file.truncate(at)
            while at < part.size:
                piece = _piece(ask, part, at, min(PIECE_BYTES, part.size - at))
                file.write(piece)
                at, came = at + len(piece), came + len(piece)
                moved(len(piece))
    finally:
        if partial.exists() and not partial.stat().st_size:  # nothing came that could be gone on from
            partial.unlink()
    _complete(part, partial, target)
    return Fetched(part, target, came)


def utc(ns: int) -> str:
    """A time for people, to the second."""
    from datetime import UTC, datetime

    try:
        return f"{datetime.fromtimestamp(ns // 1_000_000_000, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):  # a robot may send anything
        return f"{ns} ns"


def _have(folder: Path, part: RecordingPart) -> int:
    """Bytes of `part` that are here."""
    partial, target = folder / (part.name + PARTIAL), folder / part.name
    if partial.exists():
        return partial.stat().st_size
    return part.size if part.closed and target.exists() and target.stat().st_size == part.size else 0


def _resume(ask: Ask, part: RecordingPart, have: int, partial: Path) -> int:
    """Offset to resume at: the end of the local part, or 0 if that belongs to another file."""
    if not 0 < have <= part.size:
        return 0
    begin = max(have - OVERLAP_BYTES, 0)
    with partial.open("rb") as file:
        file.seek(begin)
        return have if file.read() == _piece(ask, part, begin, have - begin) else 0


def _piece(ask: Ask, part: RecordingPart, offset: int, length: int) -> bytes:
    request = RecordingRequest(name=part.name, offset=offset, length=length)
    try:
        piece = ask("bytes", request.SerializeToString())
    except FailedError as error:
        done = f"{part.name}: {offset / 1e6:.1f} of {part.size / 1e6:.1f} MB are here"
        raise FailedError(f"{error}; {done}: the same command goes on from there") from error
    if not 0 < len(piece) <= length:
        raise FailedError(
            f"{part.name}: {len(piece)} bytes came for {length} at {offset}: run the command again"
        )
    return piece


def _complete(part: RecordingPart, partial: Path, target: Path) -> None:
    """Turns the fetched part into a complete recording."""
    try:
        if part.closed:
            if message_count(partial) is None:
                raise RecordingError(f"{partial}: has no index")
            partial.replace(target)
        else:
            whole = target.with_name(f".{target.name}")
            whole.unlink(missing_ok=True)
            repair(partial, whole)
            whole.replace(target)
    except RecordingError as error:
        if part.closed:
            partial.unlink(missing_ok=True)
        raise FailedError(f"{part.name}: what came is no whole recording: {error}") from error
