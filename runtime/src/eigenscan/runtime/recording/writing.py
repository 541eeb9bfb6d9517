"""Writes recordings."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

from eigenscan.schemas.channels import CONTRACT_VERSION, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.wire import encode
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer

PROFILE = "eigenscan"
CHUNK_BYTES = 256 * 1024
MOST_CHANNELS = 65_535
"""MCAP numbers a file's channels with 16 bits, from 1 on (specification, Channel record)."""

LATEST = 2**63 - 1
"""Last instant that tools can show, ns since the epoch."""


class RecordingWriter:
    """Writes envelopes to one MCAP file. Close it, or use `with`; otherwise it has no index."""

    def __init__(self, path: Path, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.path = path
        self._file: IO[bytes] = path.open("wb")
        self._identity = _identity(path)
        with suppress(OSError):  # the file system has no locks
            fcntl.flock(self._file, fcntl.LOCK_SH | fcntl.LOCK_NB)  # protects it from deletion meanwhile
        self._writer = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile=PROFILE, library="eigenscan")
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._sequence: dict[str, int] = {}
        self.size = 0
        """Bytes of the file so far, without the chunk in progress."""
        self._unmeasured = 0
        for name, entries in (metadata or {}).items():
            self._writer.add_metadata(name, dict(entries))

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, envelope: Envelope, log_time: int, publish_time: int | None = None) -> None:
        """Adds a message, as it was received. Times are ns since the epoch.

        `publish_time`: the message's own stamp, or `log_time` where it has none.
        """
        payload = envelope.payload or encode(envelope.message)
        published = stamp_of(envelope) if publish_time is None else publish_time
        self.write_bytes(envelope.channel, envelope.key, payload, log_time, published or log_time)

    def write_bytes(
        self,
        channel: Channel,
        key: str,
        payload: bytes,
        log_time: int,
        publish_time: int | None = None,
    ) -> None:
        """Adds a message that is already encoded; `publish_time`: as `log_time`."""
        number = self._sequence.get(key, 0)
        self._sequence[key] = number + 1
        self._writer.add_message(
            channel_id=self._channel(channel, key),
            log_time=log_time,
            publish_time=log_time if publish_time is None else publish_time,
            sequence=number,
            data=payload,
        )
        self._unmeasured += len(payload)
        if self._unmeasured >= CHUNK_BYTES:  # asking the file costs as much as adding a message
            self._measure()

    def _measure(self) -> None:
        self.size, self._unmeasured = self._file.tell(), 0

    @property
    def is_there(self) -> bool:
        """Whether the file is at its path: nobody has deleted or moved it."""
        return _identity(self.path) == self._identity

    @property
    def is_deleted(self) -> bool:
        """Whether nothing is left of the file once it is closed."""
        return os.fstat(self._file.fileno()).st_nlink == 0

    def has_room(self, key: str) -> bool:
        """Whether a message of `key` can be added: a file holds MOST_CHANNELS keys."""
        return key in self._channels or len(self._channels) < MOST_CHANNELS

    def flush(self) -> None:
        """Ends the chunk in progress and writes it, so that a kill loses nothing before.

        Each flush costs some compression; once a second is cheap.
        """
        self._writer.flush()
        self._measure()

    def close(self, metadata: Mapping[str, Mapping[str, str]] | None = None) -> None:
        """Writes `metadata` and the index, and closes the file, also where it cannot be written."""
        if self._file.closed:
            return
        try:
            for name, entries in (metadata or {}).items():
                self._writer.add_metadata(name, dict(entries))
            self._writer.finish()
            self._file.close()
        except Exception:
            self.abandon()
            raise

    def abandon(self) -> None:
        """Closes the file without an index, after a failed write; it stays readable."""
        # closing writes the buffer, which fails for the same reason
        with suppress(OSError):
            self._file.close()

    def _channel(self, channel: Channel, key: str) -> int:
        if key not in self._channels:
            name = channel.schema_name
            if name not in self._schemas:
                self._schemas[name] = self._writer.register_schema(
                    name, "protobuf", descriptors(channel.message)
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


def _identity(path: Path) -> tuple[int, int] | None:
    """The same for one file under any name; None where there is none."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    return found.st_dev, found.st_ino


def stamp_of(envelope: Envelope) -> int:
    """The message's own stamp, ns since the epoch; 0 if it has none."""
    stamp = getattr(envelope.message, "timestamp", None)
    return min(max(nanoseconds(stamp), 0), LATEST) if isinstance(stamp, Timestamp) else 0


def descriptors(message: type[Message]) -> bytes:
    """FileDescriptorSet of a message type and its imports, dependencies first."""
    return _with_imports(message.DESCRIPTOR.file)


@cache  # each file of a recording holds those of its channels
def _with_imports(own: Any) -> bytes:
    ordered: dict[str, Any] = {}

    def visit(file: Any) -> None:
        if file.name in ordered:
            return
        for needed in file.dependencies:
            visit(needed)
        ordered[file.name] = file

    visit(own)
    result = FileDescriptorSet()
    for file in ordered.values():
        file.CopyToProto(result.file.add())
    return bytes(result.SerializeToString())
