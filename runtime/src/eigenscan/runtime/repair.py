"""Repairs a cut or damaged recording: keeps every readable chunk and writes an index."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, cast

from eigenscan.runtime.recording import DAMAGE, PROFILE, RecordingError, WholeReads, message_count
from eigenscan.runtime.recording.files import refuse_bomb
from eigenscan.runtime.whole import whole
from mcap.exceptions import EndOfFile, InvalidMagic
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Header, McapRecord, Message, Metadata, Schema, Statistics
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer


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
    """Whether the file ends before its end mark, or becomes unreadable at some place."""
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
        found.lost_chunks, found.cut = 0, False
        with whole(target) as fresh:
            with fresh.open("wb") as file:
                _rewrite(damaged, file, found, moved)
            if not found.messages:
                raise RecordingError(f"{damaged}: holds no whole chunk: nothing can be saved")
            if message_count(fresh) != found.messages:
                raise RecordingError(f"{fresh}: does not hold what was written: is the disk full?")
    except OSError as error:
        raise RecordingError(f"{error.filename or target}: {error.strerror}: name another place") from error
    return found


def is_sound(path: Path, moved: Moved = lambda _bytes: None) -> bool:
    """Whether a file is readable to its proper end. Raises RecordingError if it is no MCAP."""
    try:
        found = Salvage(path.stat().st_size)
        for _ in _records(path, found, moved):
            pass
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    return not (found.cut or found.lost_chunks or found.beyond)


def _records(path: Path, found: Salvage, moved: Moved) -> Iterator[McapRecord]:
    """All readable records, those of chunks one by one; counts the lost ones in `found`."""
    with path.open("rb") as file:
        whole = cast(IO[bytes], WholeReads(file))
        records = StreamReader(whole, emit_chunks=True, record_size_limit=found.size).records
        begins = 0
        while True:
            try:
                record = next(records, None)
            except (EndOfFile, *DAMAGE) as error:
                if not begins:
                    what = "no MCAP" if isinstance(error, InvalidMagic) else str(error)
                    what = what or "it ends before its first record"
                    raise RecordingError(f"{path}: is no readable recording: {what}") from error
                yield from _after(file, begins, found, moved)
                return
            if record is None:
                found.beyond = found.size - file.tell()
                return
            begins = file.tell()
            moved(begins)
            if isinstance(record, Chunk):
                yield from _of_chunk(record, found)
            else:
                yield record


def _after(file: IO[bytes], place: int, found: Salvage, moved: Moved) -> Iterator[McapRecord]:
    """What the index at the end still finds from an unreadable place on, a number of bytes into the file."""
    try:
        file.seek(0)
        index = SeekingReader(file, record_size_limit=found.size).get_summary()
    except (EndOfFile, *DAMAGE):
        index = None
    if index is None or not index.chunk_indexes:
        found.cut = True
        return
    yield from index.schemas.values()
    yield from index.channels.values()
    if index.statistics:
        yield index.statistics
    for begins in sorted({one.chunk_start_offset for one in index.chunk_indexes}):
        if not place <= begins < found.size:  # before it, or an index that nobody wrote in earnest
            continue
        file.seek(begins)
        whole = cast(IO[bytes], WholeReads(file))
        reader = StreamReader(whole, skip_magic=True, emit_chunks=True, record_size_limit=found.size)
        try:
            record = next(reader.records, None)
        except (EndOfFile, *DAMAGE):
            record = None
        moved(file.tell())
        if isinstance(record, Chunk):
            place = file.tell()
            yield from _of_chunk(record, found)
        else:
            found.lost_chunks += 1


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
