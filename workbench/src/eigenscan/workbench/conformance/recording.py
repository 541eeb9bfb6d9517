"""Checks that a recorder kept all messages, in the form of the contract's page."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from eigenscan.runtime.recording import RecordingError, is_complete
from eigenscan.runtime.recording.files import Raw, messages, opened
from eigenscan.schemas.channels import CONTRACT_VERSION, Channel, ContractError
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.wire import decode, encode
from eigenscan.workbench.conformance.check import FAILED, Check, check, skipped
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import DecodeError

CLAUSE = "Recordings"
LOST_S = 1.0
"""Messages that a kill may lose, s."""
CLOCK_NS = 1_000_000_000
"""Longest time that a log time may lie outside the run, ns."""


@dataclass(frozen=True)
class Published:
    """A message that the recorder could receive, and when it was published, ns since the epoch."""

    envelope: Envelope
    at: int


def judge_whole(folder: Path, published: Sequence[Published]) -> list[Check]:
    """Checks the files of a recorder that ended normally."""
    try:
        files = _read(folder)
    except RecordingError as error:
        return [Check("recording", CLAUSE, FAILED, str(error))]
    if not files:
        return [Check("recording", CLAUSE, FAILED, f"no .mcap in {folder}, where {{recording}} points")]
    whole = [raw for raws in files.values() for raw in raws]
    latched = [one for one in published if one.envelope.channel.qos.latched]
    open_ended = [f"{path.name} was not closed: it has no index" for path in files if not is_complete(path)]
    return [
        check("recording", CLAUSE, open_ended, f"{len(whole)} messages in {len(files)} closed files"),
        check(
            "kept",
            CLAUSE,
            list(_lost(whole, published)),
            f"all {len(published)} messages that were published, in order",
        ),
        check(
            "form",
            CLAUSE,
            [*_malformed(whole, published), *_undecodable(whole, published)],
            "key, schema, descriptors and contract version",
        ),
        check(
            "times",
            CLAUSE,
            list(_untimely(whole, published)),
            "stamps as publish times, arrival as log times",
        ),
        _rotation(files, latched),
    ]


def judge_killed(folder: Path, published: Sequence[Published], killed: int, patience: float = 1.0) -> Check:
    """Checks the files of a recorder that was killed at `killed`, ns since the epoch.

    `patience`: factor on LOST_S.
    """
    due = [one for one in published if one.at < killed - LOST_S * patience * 1e9]
    try:
        whole = [raw for raws in _read(folder).values() for raw in raws]
    except RecordingError as error:
        return Check("crash", CLAUSE, FAILED, f"after a kill: {error}")
    words = f"all {len(due)} messages that were published {LOST_S * patience:g} s before a kill"
    return check("crash", CLAUSE, [f"after a kill: {fault}" for fault in _lost(whole, due)], words)


def _read(folder: Path) -> dict[Path, list[Raw]]:
    found = {}
    for path in sorted(folder.rglob("*.mcap"), key=lambda path: (path.stat().st_mtime_ns, path.name)):
        with opened(path) as file:
            found[path] = list(messages(file))
    return found


def _lost(whole: Sequence[Raw], published: Sequence[Published]) -> Iterator[str]:
    """Keys of which not all is there, in the order in which it was published; others may lie in between."""
    kept: dict[str, list[Raw]] = defaultdict(list)
    for raw in whole:
        kept[raw[1].topic].append(raw)
    wanted: dict[str, list[Envelope]] = defaultdict(list)
    for one in published:
        wanted[one.envelope.key].append(one.envelope)
    for key, envelopes in wanted.items():
        payloads = [as_ours(envelopes[0].channel, raw[2].data) for raw in kept[key]]
        missing = at = 0
        for envelope in envelopes:
            try:
                at = payloads.index(encode(envelope.message), at) + 1
            except ValueError:
                missing += 1
        if missing:
            early = " that was published before its start" if envelopes[0].channel.qos.latched else ""
            yield f"{key}: of {len(envelopes)} messages{early}, {missing} are lost, changed or out of order"


def as_ours(channel: Channel, data: bytes) -> bytes:
    """The bytes as we would encode them, so that another encoder's order of fields does not matter."""
    try:
        return encode(decode(channel, data))
    except ContractError:
        return data


def _malformed(whole: Sequence[Raw], published: Sequence[Published]) -> Iterator[str]:
    channels = {one.envelope.key: one.envelope.channel for one in published}
    seen = set()
    for schema, channel, _ in whole:
        own = channels.get(channel.topic)
        if own is None or channel.topic in seen:
            continue
        seen.add(channel.topic)
        name = schema.name if schema else "none"
        if (name, channel.message_encoding) != (own.schema_name, "protobuf"):
            yield f"{channel.topic}: {channel.message_encoding} {name}, not protobuf {own.schema_name}"
        elif schema is None or own.schema_name not in _described(schema.data):
            yield f"{channel.topic}: its schema is no FileDescriptorSet with {own.schema_name}"
        elif channel.metadata.get("contract") != str(CONTRACT_VERSION):
            yield f"{channel.topic}: the channel's metadata has no contract = {CONTRACT_VERSION}"


def _undecodable(whole: Sequence[Raw], published: Sequence[Published]) -> Iterator[str]:
    """Keys with a sample that was to be counted, not kept."""
    channels = {one.envelope.key: one.envelope.channel for one in published}
    for _, channel, message in whole:
        own = channels.get(channel.topic)
        try:
            if own is not None:
                decode(own, message.data)
        except ContractError as error:
            del channels[channel.topic]
            yield f"{channel.topic}: keeps a sample that is to be counted only: {error}"


def _described(data: bytes) -> set[str]:
    try:
        files = FileDescriptorSet.FromString(data).file
    except DecodeError:
        return set()
    return {f"{file.package}.{message.name}" for file in files for message in file.message_type}


def _untimely(whole: Sequence[Raw], published: Sequence[Published]) -> Iterator[str]:
    channels: Mapping[str, Channel] = {one.envelope.key: one.envelope.channel for one in published}
    first, last = published[0].at - CLOCK_NS, published[-1].at + 60 * CLOCK_NS
    for _, channel, message in whole:
        own = channels.get(channel.topic)
        if own is None or own.qos.latched:
            continue
        if not first <= message.log_time <= last:
            yield f"{channel.topic}: log time {message.log_time} is not that of the arrival"
            return
        try:
            stamp = nanoseconds(decode(own, message.data).timestamp)  # type: ignore[attr-defined]
        except ContractError:  # `_undecodable` reports it
            continue
        if stamp > 0 and message.publish_time != stamp:
            yield f"{channel.topic}: publish time {message.publish_time}, the stamp is {stamp}"
            return


def _rotation(files: Mapping[Path, Sequence[Raw]], latched: Sequence[Published]) -> Check:
    name, keys = "rotation", {one.envelope.key for one in latched}
    if len(files) < 2:
        return skipped(name, CLAUSE, "one file: its command asks for no rotation that this run would reach")
    problems, received = [], set[str]()  # a file may begin before all of them have come
    for path, raws in files.items():
        first = {raw[1].topic for raw in raws[: len(keys)]}
        if missing := received - first:
            problems.append(f"{path.name} does not begin with {min(missing)}")
        received |= keys & {raw[1].topic for raw in raws}
    words = f"each of {len(files) - 1} further files begins with map and models"
    return check(name, CLAUSE, problems, words)
