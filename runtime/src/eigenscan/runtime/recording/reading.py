"""Reads the messages of a recording: of one file, or of a recorder's folder of files."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from eigenscan.runtime.recording.contents import contents
from eigenscan.runtime.recording.files import is_indexed, messages, opened, parts
from eigenscan.schemas.channels import CONTRACT_VERSION, Channel, find
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import decode, encode
from mcap.reader import make_reader
from mcap.records import Channel as McapChannel
from mcap.records import Message, Schema


@dataclass(frozen=True)
class Record:
    """One message of a recording. Times are ns since the epoch."""

    envelope: Envelope
    log_time: int
    publish_time: int
    size: int


def read(path: Path, begin: int = 0) -> Iterator[Record]:
    """Messages of the contract's channels, of one file or of all files in a folder, in order of log time.

    With `begin` (log time, ns), the newest earlier message of each latched key comes first, then all messages
    from `begin` on. Repetitions at the start of a rotated file are left out. A file without an index (its
    writer was killed) is read in its own order, up to its last whole chunk (see `is_complete`).
    Raises RecordingError if the file is missing, no MCAP, or damaged, or if a key of the contract has another
    schema or contract version.
    """
    if not path.is_dir():
        yield from _read_file(path, begin)
        return
    latched: dict[str, bytes] = {}
    held: dict[str, Record] = {}  # each file has a newest earlier message of a key
    for record in _merged(parts(path), begin):
        if record.envelope.channel.qos.latched:
            key, payload = record.envelope.key, encode(record.envelope.message)
            if latched.get(key) == payload:
                continue
            latched[key] = payload
            if record.log_time < begin:
                held.pop(key, None)  # keeps the order of time
                held[key] = record
                continue
        yield from held.values()
        held.clear()
        yield record
    yield from held.values()


def _merged(files: list[Path], begin: int) -> Iterator[Record]:
    """Records of all files by log time. Each file is open only while its records are read."""
    waiting = sorted(((contents(file).begin, number) for number, file in enumerate(files)), reverse=True)
    running: list[tuple[int, int, Record, Iterator[Record]]] = []

    def advance(number: int, records: Iterator[Record]) -> None:
        record = next(records, None)
        if record is not None:
            heapq.heappush(running, (record.log_time, number, record, records))

    while waiting or running:
        while waiting and (not running or waiting[-1][0] <= running[0][0]):
            number = waiting.pop()[1]
            advance(number, _read_file(files[number], begin))
        if running:
            _, number, record, records = heapq.heappop(running)
            yield record
            advance(number, records)


def _read_file(path: Path, begin: int) -> Iterator[Record]:
    with opened(path) as file:
        early = _latched_topics(path) if begin else ()
        held: dict[str, _Found] = {}
        known: dict[str, tuple[Channel, dict[str, str]] | None] = {}
        for schema, channel, message in messages(file, begin, early):
            if channel.topic not in known:
                known[channel.topic] = find(channel.topic)
            own = known[channel.topic]
            if own is None:
                continue
            found = _Found(*own, _declared(schema, channel), message)
            if message.log_time >= begin:
                yield from _records(held)
                yield found.record()
            elif found.channel.qos.latched:
                held.pop(channel.topic, None)  # keeps the order of time
                held[channel.topic] = found
        yield from _records(held)


@dataclass(frozen=True)
class _Found:
    """A message on a key of the contract, not decoded yet, because models take long."""

    channel: Channel
    address: Mapping[str, str]
    encoding: str
    message: Message

    def record(self) -> Record:
        """The decoded message. Raises ContractError if it does not have its channel's schema."""
        own = self.message
        payload = decode(self.channel, own.data, self.encoding)
        return Record(
            Envelope(self.channel, self.address, payload), own.log_time, own.publish_time, len(own.data)
        )


def _records(held: dict[str, _Found]) -> Iterator[Record]:
    """Records of all messages in `held`, and empties it."""
    for found in held.values():
        yield found.record()
    held.clear()


def _declared(schema: Schema | None, channel: McapChannel) -> str:
    """A channel's encoding as Zenoh would declare it."""
    contract = channel.metadata.get("contract", str(CONTRACT_VERSION))
    return f"application/{channel.message_encoding};{schema.name}/{contract}" if schema else ""


def _latched_topics(path: Path) -> list[str]:
    with opened(path) as file:
        summary = make_reader(file).get_summary() if is_indexed(file) else None
        topics = [channel.topic for channel in summary.channels.values()] if summary else []
    found = [(topic, find(topic)) for topic in topics]
    return [topic for topic, one in found if one and one[0].qos.latched]
