"""Messages of any MCAP file: by its index, or front to back if it was cut; also of an .mcap.zstd."""

from __future__ import annotations

import os
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import IO

from eigenscan.runtime.recording.files import MOST_CHUNK_BYTES, MOST_CHUNK_TIMES, refuse_bombs
from eigenscan.workbench.logs.log import RECORDER_LAG_NS, LogError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Channel, Message, MessageIndex, Schema, Statistics
from mcap.stream_reader import StreamReader
from zstandard import ZstdDecompressor, ZstdError

Item = tuple[Schema | None, Channel, Message]
DAMAGE = (
    McapError,
    struct.error,
    ValueError,
    RuntimeError,
    EOFError,
    OSError,
    ZstdError,
    OverflowError,
    MemoryError,
    LookupError,
)
"""Errors that the library and the decompressors raise for damaged bytes."""


class McapFile:
    """An MCAP file; iterating it never raises over damage, it counts it."""

    def __init__(self, path: Path, counters: Counter[str], copies: Copies | None = None) -> None:
        self.path, self.counters = path, counters
        self._copies = copies or Copies()
        self.progress = 0.0
        self.profile, self._indexed, self._total = "", False, 0
        with self._copies.opened(path) as file:
            self._size = max(file.seek(0, os.SEEK_END), 1)
            file.seek(0)
            try:
                refuse_bombs(file)
            except ValueError as error:
                raise LogError(f"{path}: is no readable MCAP: {error}") from error
            except DAMAGE:  # cut within a chunk's head
                pass
            file.seek(0)
            try:
                reader = make_reader(file)
                self.profile = reader.get_header().profile
                summary = reader.get_summary()
            except DAMAGE:
                summary = None
        if summary is not None and summary.channels:
            statistics: Statistics | None = summary.statistics
            self._indexed = True
            self._total = statistics.message_count if statistics else 0
            self._known = {
                (
                    channel.topic,
                    channel.message_encoding,
                    summary.schemas[channel.schema_id].name if channel.schema_id in summary.schemas else "",
                )
                for channel in summary.channels.values()
            }
        else:
            self._known = {
                (channel.topic, channel.message_encoding, schema.name if schema else "")
                for schema, channel, _ in self.messages(None)
            }
            self.counters.clear()

    def channels(self) -> set[tuple[str, str, str]]:
        """Topic, message encoding and schema name of each channel."""
        return self._known

    def messages(self, topics: list[str] | None) -> Iterator[Item]:
        """Messages of `topics` (None: all), by time of recording unless that was set back."""
        with self._copies.opened(self.path) as file:
            try:
                if self._indexed:
                    sort = not _goes_back(file)
                    file.seek(0)
                    found = make_reader(file).iter_messages(topics=topics, log_time_order=sort)
                    for number, item in enumerate(found):
                        self.progress = min(number / max(self._total, 1), 1.0)
                        yield item
                else:
                    yield from self._front_to_back(file, topics)
            except DAMAGE:
                self.counters["truncated_file"] += 1

    def _front_to_back(self, file: IO[bytes], topics: list[str] | None) -> Iterator[Item]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in StreamReader(file, record_size_limit=self._size).records:
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                if topics is None or channel.topic in topics:
                    self.progress = file.tell() / self._size
                    yield schemas.get(channel.schema_id), channel, record


def _goes_back(file: IO[bytes]) -> bool:
    """Whether the recorder's clock was set back: a channel's times of recording lie before earlier ones."""
    newest: dict[int, int] = {}
    with suppress(*DAMAGE):
        summary = make_reader(file).get_summary()
        places = [chunk.message_index_offsets for chunk in summary.chunk_indexes] if summary else []
        for channel, place in chain.from_iterable(each.items() for each in places):
            file.seek(place + 1 + 8)  # behind the record's kind and length
            index = MessageIndex.read(ReadDataStream(file))
            for time, _ in sorted(index.records, key=itemgetter(1)):  # in the order of the chunk
                if time < newest.get(channel, time) - RECORDER_LAG_NS:
                    return True
                newest[channel] = max(time, newest.get(channel, time))
    return False


class Copies:
    """Inflates files that were recorded with --compression-mode file, and keeps the last copy.

    It has no name, so it is gone even where the process is killed.
    """

    def __init__(self) -> None:
        self._kept: tuple[Path, IO[bytes]] | None = None

    def __del__(self) -> None:
        self._keep(None)

    def _keep(self, copy: tuple[Path, IO[bytes]] | None) -> None:
        if self._kept:
            self._kept[1].close()
        self._kept = copy

    @contextmanager
    def opened(self, path: Path) -> Iterator[IO[bytes]]:
        """The file, or what it holds inflated, from its start. Raises LogError."""
        if path.suffix != ".zstd":
            with path.open("rb") as file:
                yield file
            return
        if self._kept and self._kept[0] != path:
            self._keep(None)  # makes room first
        copy, self._kept = self._kept or (path, _inflated(path)), None  # who reads it too inflates it again
        copy[1].seek(0)
        try:
            yield copy[1]
        finally:
            self._keep(copy)


def _inflated(path: Path) -> IO[bytes]:
    with ExitStack() as closing:
        try:
            whole = closing.enter_context(tempfile.TemporaryFile())
            _inflate(path, whole)
        except OSError as error:
            raise LogError(
                f"{path}: cannot be decompressed to {tempfile.gettempdir()}: {error.strerror}: "
                "make room there, or use zstd -d"
            ) from error
        closing.pop_all()
        return whole


def _inflate(path: Path, whole: IO[bytes]) -> None:
    most = max(MOST_CHUNK_BYTES, MOST_CHUNK_TIMES * path.stat().st_size)
    # what comes before damage is read
    with path.open("rb") as source, suppress(ZstdError):
        for part in ZstdDecompressor().read_to_iter(source):
            if whole.tell() + len(part) > most:
                raise LogError(f"{path}: would become more than {most / 1e6:.0f} MB: is it a recording?")
            whole.write(part)
    whole.flush()
