"""The pipeline's own MCAP: a channel per key, protobuf schemas in the file, zstd chunks, indexed."""

from __future__ import annotations

import heapq
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

from eigenscan.schemas.channels import CONTRACT_VERSION, Channel, ContractError, find
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import decode, encode
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from mcap.exceptions import EndOfFile, InvalidMagic, McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Message as McapMessage
from mcap.records import Schema
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer
from zstandard import ZstdError

PROFILE = "eigenscan"
REPAIRED = ".repaired.mcap"
"""How the name of a repaired copy ends."""
CHUNK_BYTES = 256 * 1024
DAMAGE = (
    McapError,
    ContractError,
    ZstdError,
    struct.error,
    ValueError,
    KeyError,
    MemoryError,
    OverflowError,
)
"""What reading a damaged file may raise."""


class RecordingError(ValueError):
    """A file that is no readable recording; the message names it."""


@dataclass(frozen=True)
class Record:
    """One message of a recording. Times are ns since the epoch."""

    envelope: Envelope
    log_time: int
    publish_time: int
    size: int


class RecordingWriter:
    """Writes envelopes to one MCAP file. Close it (or use `with`), else it has no index."""

    def __init__(self, path: Path, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._file: IO[bytes] = path.open("wb")
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="eigenscan")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        for name, entries in (metadata or {}).items():
            self._writer.add_metadata(name, dict(entries))

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def write(self, envelope: Envelope, log_time: int, publish_time: int | None = None) -> None:
        """Adds a message. `publish_time` is `log_time` where it is not known."""
        self.write_bytes(envelope.channel, envelope.key, encode(envelope.message), log_time, publish_time)

    def write_bytes(
        self,
        channel: Channel,
        key: str,
        payload: bytes,
        log_time: int,
        publish_time: int | None = None,
    ) -> None:
        """Adds a message that is already encoded."""
        number = self._sequence.get(key, 0)
        self._sequence[key] = number + 1
        self._writer.add_message(
            channel_id=self._channel(channel, key),
            log_time=log_time,
            publish_time=log_time if publish_time is None else publish_time,
            sequence=number,
            data=payload,
        )

    @property
    def size(self) -> int:
        """Bytes of the file so far, without the chunk in progress."""
        return self._file.tell()

    def flush(self) -> None:
        """Ends the chunk in progress and hands it to the operating system: a kill loses nothing before.

        Each flush costs some compression; once a second is cheap.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        """Writes the index and closes the file."""
        if not self._file.closed:
            self._writer.finish()  # type: ignore[no-untyped-call]
            self._file.close()

    def abandon(self) -> None:
        """Closes the file as it is, after a write that failed: without an index, but readable."""
        # closing writes what is buffered, which fails for the same reason
        with suppress(OSError):
            self._file.close()

    def _channel(self, channel: Channel, key: str) -> int:
        if key not in self._channels:
            name = channel.schema_name
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(
                    name, "protobuf", _descriptors(channel.message)
                )
            qos = channel.qos
            self._channels[key] = self._writer.register_channel(
                topic=key,
                message_encoding="protobuf",
                schema_id=self._schemas[name],
                metadata={
                    "contract": str(CONTRACT_VERSION),
                    "channel": channel.name,
                    "priority": qos.priority.value,
                    "block": str(qos.block).lower(),
                    "latched": str(qos.latched).lower(),
                },
            )
        return self._channels[key]


def parts(path: Path) -> list[Path]:
    """The files of a recording: itself, or those of a folder that a recorder filled.

    Of a file and its repaired copy only the copy counts. Raises RecordingError for a folder without any.
    """
    if not path.is_dir():
        return [path]
    files = {file.name: file for file in sorted(path.glob("*.mcap")) if not file.match("*.reference.mcap")}
    for name in list(files):
        if name.endswith(REPAIRED):
            files.pop(f"{name.removesuffix(REPAIRED)}.mcap", None)
    if not files:
        raise RecordingError(f"{path}: is a folder that holds no .mcap")
    return list(files.values())


def read(path: Path) -> Iterator[Record]:
    """Messages of our channels, of one file or of all in a folder; what is not ours is skipped.

    In order of log time, by the index. What a rotated file repeats at its start is left out.
    Where the writer was killed and there is no index: in order of the
    file, up to its last whole chunk (see `is_complete`).
    Raises RecordingError where the file is missing, no MCAP, or damaged, or holds another schema or contract
    version on one of our keys.
    """
    if not path.is_dir():
        yield from _read_file(path)
        return
    latched: dict[str, bytes] = {}
    files = [_read_file(part) for part in parts(path)]
    for record in heapq.merge(*files, key=lambda record: record.log_time):
        if record.envelope.channel.qos.latched:
            key, payload = record.envelope.key, encode(record.envelope.message)
            if latched.get(key) == payload:
                continue
            latched[key] = payload
        yield record


def _read_file(path: Path) -> Iterator[Record]:
    try:
        with path.open("rb") as file:
            for schema, channel, message in _messages(file, indexed=_is_indexed(file)):
                found = find(channel.topic)
                if found is None:
                    continue
                payload = decode(found[0], message.data, _declared(schema, channel))
                yield Record(
                    Envelope(found[0], found[1], payload),
                    message.log_time,
                    message.publish_time,
                    len(message.data),
                )
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except DAMAGE as error:
        raise RecordingError(f"{path}: is no readable recording: {error}") from error


def _declared(schema: Schema | None, channel: McapChannel) -> str:
    """Encoding that the file declares for a channel, as it would read over Zenoh."""
    contract = channel.metadata.get("contract", str(CONTRACT_VERSION))
    return f"application/{channel.message_encoding};{schema.name}/{contract}" if schema else ""


def is_complete(path: Path) -> bool:
    """Whether the file was closed by its writer. Raises RecordingError where it cannot be read at all."""
    return message_count(path) is not None


def message_count(path: Path) -> int | None:
    """Number of messages by the index; None where the writer was killed before it wrote one.

    Raises RecordingError where the file is missing, no MCAP, or damaged.
    """
    counts = [_message_count(part) for part in parts(path)]
    return None if None in counts else sum(count or 0 for count in counts)


def _message_count(path: Path) -> int | None:
    try:
        with path.open("rb") as file:
            if not _is_indexed(file):
                return None
            summary = make_reader(file).get_summary()
            return summary.statistics.message_count if summary and summary.statistics else 0
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except DAMAGE as error:
        raise RecordingError(f"{path}: is no readable recording: {error}") from error


def _is_indexed(file: IO[bytes]) -> bool:
    """Whether the file ends as an MCAP; raises InvalidMagic where it does not start as one."""
    start = file.read(len(MCAP0_MAGIC))
    if start != MCAP0_MAGIC:
        raise InvalidMagic(start)
    rest = file.seek(0, os.SEEK_END) - len(MCAP0_MAGIC)
    file.seek(-min(rest, len(MCAP0_MAGIC)), os.SEEK_END)
    end = file.read()
    file.seek(0)
    return end == MCAP0_MAGIC


def _messages(file: IO[bytes], *, indexed: bool) -> Iterator[tuple[Schema | None, McapChannel, McapMessage]]:
    if indexed:
        yield from make_reader(file, validate_crcs=True).iter_messages()
        return
    whole = cast(IO[bytes], WholeReads(file))
    with suppress(EndOfFile):
        yield from NonSeekingReader(whole, validate_crcs=True).iter_messages(log_time_order=False)


class WholeReads:
    """A file whose reads give all that was asked for; `mcap` takes a cut chunk for a whole one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """`size` bytes. Raises EndOfFile where there are fewer."""
        data = self._file.read(size)
        if len(data) < size:
            raise EndOfFile
        return data


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Metadata records by name; of a folder, of its first file. Raises RecordingError."""
    path = parts(path)[0]
    try:
        with path.open("rb") as file:
            return {entry.name: dict(entry.metadata) for entry in make_reader(file).iter_metadata()}
    except OSError as error:
        raise RecordingError(f"{path}: cannot be read: {error.strerror}") from error
    except DAMAGE as error:
        raise RecordingError(f"{path}: is no readable recording: {error}") from error


def _descriptors(message: type[Message]) -> bytes:
    """FileDescriptorSet of a message and all that it imports, dependencies first."""
    ordered: dict[str, Any] = {}

    def visit(file: Any) -> None:
        if file.name in ordered:
            return
        for needed in file.dependencies:
            visit(needed)
        ordered[file.name] = file

    visit(message.DESCRIPTOR.file)
    result = FileDescriptorSet()
    for file in ordered.values():
        file.CopyToProto(result.file.add())
    return bytes(result.SerializeToString())
