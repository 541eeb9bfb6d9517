"""Repairs a cut or damaged recording: keeps every readable chunk and writes an index."""

from __future__ import annotations

import mmap
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from errno import EIO
from functools import partial
from pathlib import Path
from typing import IO, cast

from eigenscan.runtime.errors import fix_of
from eigenscan.runtime.recording import DAMAGE, PROFILE, RecordingError, WholeReads, message_count
from eigenscan.runtime.recording.files import is_indexed, opened, refuse_bomb, refuse_other_chunks
from eigenscan.schemas.whole import whole
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

RECORD_HEAD, CHUNK_HEAD = 9, 49
"""Bytes of a record before its content, and of a chunk's record, less its data and its compression's name."""
_CHUNK = re.compile(rb"\x06.{36}(?:(\x04\0{3}zstd|\x03\0{3}lz4)|\0{4})", re.DOTALL)
"""A chunk's head up to the length of its data: opcode, length, times, size, checksum, compression."""


@dataclass
class Salvage:
    """Result of the repair of a file of `size` bytes."""

    size: int
    messages: int = 0
    lost_chunks: int = 0
    """Chunks that do not inflate, or whose checksum is wrong."""
    unnamed_messages: int = 0
    """Messages of channels that only a lost chunk defined."""
    stated_messages: int | None = None
    """Messages that the file had, by its own summary, if that is readable."""
    cut: bool = False
    """Whether the file ends before its end mark."""
    breaks: int = 0
    """Places where it is unreadable, and behind which it goes on."""
    beyond: int = 0
    """Bytes after its proper end: of another recording, say."""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    @property
    def lost_messages(self) -> int | None:
        """Messages that could not be saved; None: nobody knows how many."""
        if self.stated_messages is not None and self.stated_messages >= self.messages:
            return self.stated_messages - self.messages
        return None if self.cut or self.lost_chunks else self.unnamed_messages


Moved = Callable[[int], object]
"""Called with the number of bytes read so far, in each pass over a file."""


def repair(damaged: Path, target: Path, moved: Moved = lambda _bytes: None) -> Salvage:
    """Writes all readable messages of `damaged`, foreign ones too, to the new file `target`.

    It reads the file twice: first for the channels, which an index at the end may define, then for the
    messages. Raises RecordingError if `damaged` is no MCAP or holds no message, or if `target` exists.
    """
    if target.exists():
        raise RecordingError(f"{target}: exists already: give another file with -o")
    try:
        found = Salvage(damaged.stat().st_size)
        for record in _records(damaged, found, moved):
            if isinstance(record, Schema):
                found.schemas[record.id] = record
            elif isinstance(record, Channel):
                found.channels[record.id] = record
            elif isinstance(record, Statistics):
                found.stated_messages = record.message_count
        found.lost_chunks, found.breaks, found.cut = 0, 0, False
        with whole(target) as fresh:
            with fresh.open("wb") as file:
                _rewrite(damaged, file, found, moved)
            if not found.messages:
                raise RecordingError(f"{damaged}: holds no whole chunk: nothing can be saved")
            if message_count(fresh) != found.messages:
                raise RecordingError(f"{fresh}: does not hold what was written: is the disk full?")
    except OSError as error:
        place = error.filename or (damaged if error.errno == EIO else target)
        fix = fix_of(error, ": name another place")
        raise RecordingError(f"{place}: {error.strerror}{fix}") from error
    return found


def is_sound(path: Path, moved: Moved = lambda _bytes: None) -> bool:
    """Whether a file is readable to its proper end, with a sound index.

    Raises RecordingError if it is no MCAP.
    """
    try:
        found = Salvage(path.stat().st_size)
        for _ in _records(path, found, moved):
            pass
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}{fix_of(error)}") from error
    if found.cut or found.breaks or found.lost_chunks or found.beyond:
        return False
    with suppress(RecordingError), opened(path) as file:
        if is_indexed(file):
            refuse_other_chunks(file, make_reader(file))
            return True
    return False


def _records(path: Path, found: Salvage, moved: Moved) -> Iterator[McapRecord]:
    """All readable records, those of chunks one by one; counts the lost ones in `found`.

    Behind an unreadable place it goes on at the next chunk.
    """
    with path.open("rb") as file:
        reader = partial(StreamReader, cast(IO[bytes], WholeReads(file)), emit_chunks=True)
        records, ends, sound, chunks = reader(record_size_limit=found.size).records, 0, 0, 0
        while True:
            try:
                record = next(records, None)
            except (EndOfFile, *DAMAGE) as error:
                if not ends:
                    what = "no MCAP" if isinstance(error, InvalidMagic) else str(error)
                    what = what or "it ends before its first record"
                    raise RecordingError(f"{path}: is no readable recording: {what}") from error
                begins = _next_chunk(file, sound)
                if begins is None:
                    found.cut = True
                    return
                found.breaks += 1
                file.seek(begins)
                records = reader(skip_magic=True, record_size_limit=found.size).records
                continue
            if record is None:
                found.beyond = found.size - file.tell()
                return
            moved(file.tell())
            if isinstance(record, Chunk):
                inside, chunks = _of_chunk(record, found), chunks + 1
                begins = file.tell() - _size(record)
                # a damaged one may be shorter than it states, and hide the next; within it we look only once
                sound = file.tell() if inside or begins < ends else begins + 1
                yield from inside
            else:
                sound = file.tell()
                if isinstance(record, Statistics) and found.breaks:
                    found.lost_chunks += max(record.chunk_count - chunks, 0)
                yield record
            ends = max(ends, file.tell())


def _size(chunk: Chunk) -> int:
    """Of its record, bytes."""
    return CHUNK_HEAD + len(chunk.compression.encode()) + len(chunk.data)


def _next_chunk(file: IO[bytes], place: int) -> int | None:
    """Where the next chunk begins from a place in the file on, by what stands in the head of each."""
    with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        while found := _CHUNK.search(content, place):
            begins, place = found.start(), found.start() + 1
            size, packed, unpacked = (
                int.from_bytes(content[at : at + 8], "little")
                for at in (begins + 1, found.end(), begins + 25)
            )
            size += RECORD_HEAD
            if size != found.end() + 8 - begins + packed or begins + size > len(content):
                continue
            if found[1] or packed == unpacked:
                return begins
    return None


def _of_chunk(chunk: Chunk, found: Salvage) -> list[McapRecord]:
    try:
        refuse_bomb(chunk.compression.encode(), chunk.data, len(chunk.data), chunk.uncompressed_size)
        return breakup_chunk(chunk, validate_crc=True)
    except (EndOfFile, *DAMAGE):
        found.lost_chunks += 1
        return []


def _rewrite(damaged: Path, file: IO[bytes], found: Salvage, moved: Moved) -> None:
    writer = Writer(file, compression=CompressionType.ZSTD)
    ids: dict[int, int] = {}
    started = False
    for record in _records(damaged, found, moved):
        if not started:
            profile = record.profile if isinstance(record, Header) else PROFILE
            writer.start(profile=profile, library="eigenscan repair")
            started = True
        if isinstance(record, Metadata):
            writer.add_metadata(record.name, record.metadata)
        elif isinstance(record, Attachment):
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, record.data
            )
        elif isinstance(record, Message):
            if record.channel_id not in ids and not _register(writer, ids, record.channel_id, found):
                found.unnamed_messages += 1
                continue
            writer.add_message(
                ids[record.channel_id], record.log_time, record.data, record.publish_time, record.sequence
            )
            found.messages += 1
    writer.finish()


def _register(writer: Writer, ids: dict[int, int], channel_id: int, found: Salvage) -> bool:
    """Registers a channel with the writer; False if its definition is lost."""
    channel = found.channels.get(channel_id)
    if channel is None or (channel.schema_id and channel.schema_id not in found.schemas):
        return False
    schema = found.schemas.get(channel.schema_id)
    schema_id = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
    ids[channel_id] = writer.register_channel(
        channel.topic, channel.message_encoding, schema_id, dict(channel.metadata)
    )
    return True
