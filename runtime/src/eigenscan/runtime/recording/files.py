"""Reads the files of a recording, also cut and damaged ones."""

from __future__ import annotations

import os
import shlex
import struct
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, cast

import lz4.frame
import zstandard
from eigenscan.runtime.errors import fix_of
from eigenscan.schemas.channels import ContractError
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Channel, ChunkIndex, Message, Schema
from mcap.writer import MCAP0_MAGIC
from zstandard import ZstdError

REPAIRED = ".repaired.mcap"
"""End of a repaired copy's name."""
DAMAGE = (
    McapError,
    ContractError,
    ZstdError,
    struct.error,
    ValueError,
    KeyError,
    MemoryError,
    OverflowError,
    RuntimeError,  # of lz4
)
"""Errors that reading a damaged file may raise."""

Raw = tuple[Schema | None, Channel, Message]


_OTHER_LOGS = {b"#ROSBAG V": "a ROS 1 bag", b"SQLite format 3\0": "a ROS 2 bag's database"}
"""First bytes of other logs that people take for recordings."""


MOST_CHUNK_BYTES = 2**26
"""Inflated size that any chunk may have. The recorder's chunks have 256 KiB, or one message."""
MOST_CHUNK_TIMES = 1000
"""Times its own size that a larger chunk may inflate to. A large site's map inflates some hundred times."""
BLOCK_BYTES = 2**20
"""Bytes of a file that are read at a time."""
_CHUNK, _CHUNK_HEAD = 6, struct.Struct("<QQQII")
_RECORD_HEAD = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI8s")
"""With its head and the magic behind it: opcode, length, starts of summary and offsets, checksum."""


class RecordingError(ValueError):
    """A file that cannot be read as a recording; the message names it."""


class WholeReads:
    """A file whose short reads are errors: `mcap` would accept a cut chunk as whole."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """Reads `size` bytes. Raises EndOfFile if there are fewer."""
        data = self._file.read(size)
        if len(data) < size:
            raise EndOfFile
        return data


def inflates_to(compression: bytes, data: bytes, stated: int) -> int:
    """Size of a chunk when inflated: the larger of `stated` and the size in the head of its `data`."""
    own = 0
    if compression == b"zstd":
        own = zstandard.frame_content_size(data)
    elif compression == b"lz4":
        own = int(lz4.frame.get_frame_info(data)["content_size"])
    return max(own, stated)


def refuse_bombs(file: IO[bytes]) -> None:
    """Raises ValueError if a chunk of an MCAP would fill the memory. Reads only the chunks' heads."""
    end = file.seek(0, os.SEEK_END)
    file.seek(len(MCAP0_MAGIC))
    while len(head := file.read(_RECORD_HEAD.size)) == _RECORD_HEAD.size:
        kind, size = _RECORD_HEAD.unpack(head)
        begin = file.tell()
        if kind == _CHUNK:
            start = file.read(min(size, 128))
            if len(start) < _CHUNK_HEAD.size:  # cut here, or damaged: the reader reports it
                break
            _, _, stated, _, length = _CHUNK_HEAD.unpack_from(start)
            compression = start[_CHUNK_HEAD.size :][:length]
            data = start[_CHUNK_HEAD.size + length + 8 :]
            refuse_bomb(compression, data, size, stated)
        if begin + size > end:  # cut or damaged; file systems refuse to seek to some places so far away
            break
        file.seek(begin + size)
    file.seek(0)


def refuse_bomb(compression: bytes, data: bytes, size: int, stated: int) -> None:
    """Raises ValueError if a chunk of `size` bytes would fill the memory; `data`: at least its start."""
    becomes = stated
    with suppress(ZstdError, RuntimeError):  # a chunk that does not inflate is reported when it is read
        becomes = inflates_to(compression, data, stated)
    if becomes > max(MOST_CHUNK_BYTES, MOST_CHUNK_TIMES * size):
        raise ValueError(f"a chunk of {size} bytes would become {becomes}")


def is_only_begun(path: Path) -> bool:
    """Whether a file is cut before the end of its first bytes, the magic."""
    return path.stat().st_size < len(MCAP0_MAGIC)


def parts(path: Path) -> list[Path]:
    """The files of a recording: the file itself, or those in a recorder's folder.

    A repaired copy replaces its original. Left out are hidden files, which macOS puts beside each on a stick,
    and a file that was cut before its first message: a recorder was killed as it began it. Raises
    RecordingError for a folder without recordings.
    """
    if not path.is_dir():
        return [path]
    named = [file for file in sorted(path.glob("[!.]*.mcap")) if not file.match("*.reference.mcap")]
    files = {file.name: file for file in named if not is_only_begun(file)}
    for name in list(files):
        if name.endswith(REPAIRED):
            files.pop(f"{name.removesuffix(REPAIRED)}.mcap", None)
    if not files:
        raise RecordingError(f"{path}: is a folder that holds no .mcap" + (" with messages" if named else ""))
    return list(files.values())


@contextmanager
def opened(path: Path) -> Iterator[IO[bytes]]:
    """Opens the file at `path`. Raises RecordingError if it is missing, or what is read of it is damaged."""
    try:
        with path.open("rb") as file:
            _refuse_others(path, file)
            refuse_bombs(file)
            yield file
    except RecordingError:
        raise
    except InvalidMagic as error:
        raise RecordingError(
            f"{path}: is no readable recording: no MCAP; eigenscan import makes one of a log"
        ) from error
    except OSError as error:
        fix = fix_of(error, ": check the path")
        raise RecordingError(f"{path}: cannot be read: {error.strerror}{fix}") from error
    except ContractError as error:
        raise RecordingError(f"{path}: {error}: read it with the release that wrote it") from error
    except DAMAGE as error:
        raise RecordingError(
            f"{path}: is damaged ({error}): eigenscan repair {shlex.quote(str(path))} saves what can be read"
        ) from error


def _refuse_others(path: Path, file: IO[bytes]) -> None:
    """Raises RecordingError for a file of another format, with the command that converts it."""
    start = file.read(max(map(len, _OTHER_LOGS)))
    file.seek(0)
    for magic, name in _OTHER_LOGS.items():
        if start.startswith(magic):
            raise RecordingError(
                f"{path}: is {name}, not a recording: "
                f"eigenscan import {shlex.quote(str(path))} makes one of it"
            )


def is_indexed(file: IO[bytes]) -> bool:
    """Whether the file ends as an MCAP does, with a sound summary. Raises InvalidMagic for another start."""
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        raise InvalidMagic(start)
    size = file.seek(0, os.SEEK_END)
    file.seek(-min(size, _FOOTER.size), os.SEEK_END)
    end = file.read()
    is_sound = end.endswith(MCAP0_MAGIC) and size >= 2 * len(MCAP0_MAGIC)
    if is_sound and len(end) == _FOOTER.size:
        _, _, begins, _, checksum, _ = _FOOTER.unpack(end)
        is_sound = not (checksum and begins) or checksum == _checksum(file, begins, size)
    file.seek(0)
    return is_sound


def _checksum(file: IO[bytes], begins: int, size: int) -> int:
    """Of the summary that begins there, up to the footer's own checksum (specification, Footer)."""
    left, found = size - len(MCAP0_MAGIC) - 4 - begins, 0
    file.seek(min(begins, size))
    while left > 0:
        block = file.read(min(left, BLOCK_BYTES))
        left, found = left - len(block), zlib.crc32(block, found)
    return found


def messages(file: IO[bytes], begin: int = 0, early: Iterable[str] = ()) -> Iterator[Raw]:
    """Messages from log time `begin` (ns) on, and earlier ones of the topics `early`.

    With an index they come in order of log time. Without one, or with a damaged one, all messages come in
    the file's order, up to its last whole chunk or to the damage. Raises ValueError at the end if a chunk
    that the index names is not there.
    """
    reader = _indexed(file)
    if reader is None:
        whole = cast(IO[bytes], WholeReads(file))
        try:
            with suppress(EndOfFile):
                yield from NonSeekingReader(whole, validate_crcs=True).iter_messages(log_time_order=False)
        except InvalidMagic as error:  # its start was looked at
            raise ValueError("its end is not that of an MCAP") from error
        return
    topics = list(early)
    if topics and begin:
        yield from reader.iter_messages(topics=topics, ending_before=begin)
    yield from reader.iter_messages(starting_at=begin)
    refuse_other_chunks(file, reader)


def _indexed(file: IO[bytes]) -> McapReader | None:
    """Reads by the index; None if there is none or it is damaged, with the file at its start."""
    reader = found = None
    if is_indexed(file):
        with suppress(EndOfFile, OSError, *DAMAGE):  # OSError: a damaged offset cannot be sought
            reader = make_reader(file, validate_crcs=True)
            found = reader.get_summary()
    file.seek(0)
    # records that were overwritten by zeros are passed over
    if found and found.statistics and found.statistics.chunk_count != len(found.chunk_indexes):
        return None
    return reader if found else None


def refuse_other_chunks(file: IO[bytes], reader: McapReader) -> None:
    """Raises ValueError where the file does not hold the chunks that its index names."""
    summary = reader.get_summary()
    for index in summary.chunk_indexes if summary else ():
        _refuse_other_chunk(file, index)


def _refuse_other_chunk(file: IO[bytes], index: ChunkIndex) -> None:
    """Raises ValueError where the file does not hold the chunk of `index`.

    `mcap` takes a chunk whose head was overwritten by zeros for an empty one.
    """
    file.seek(index.chunk_start_offset)
    head = file.read(_RECORD_HEAD.size + _CHUNK_HEAD.size)
    size = index.chunk_length - _RECORD_HEAD.size
    times = index.message_start_time, index.message_end_time
    found = len(head) == _RECORD_HEAD.size + _CHUNK_HEAD.size and (
        *_RECORD_HEAD.unpack_from(head),
        *_CHUNK_HEAD.unpack_from(head, _RECORD_HEAD.size)[:3],
    )
    if found != (_CHUNK, size, *times, index.uncompressed_size):
        raise ValueError(f"the chunk at byte {index.chunk_start_offset} is damaged")
