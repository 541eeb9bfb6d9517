"""A neighbour of a later minor version: fields and enum values that nobody here knows change nothing."""

import hashlib
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from eigenscan.eigenspace.model import set_version
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.recording import read
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.wire import decode, encode, encoding
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from google.protobuf.message import Message

DEPOT = Path(__file__).parent / "first_release/depot.mcap"
LATER = bytes([0xFA, 0x7F, 3]) + b"new"
"""Field 2047 of three bytes; in messages within messages as well."""
CORES: dict[str, Callable[[], Core]] = {
    "scan-ingest": lambda: ScanIngestCore(ScanIngestSettings()),
    "projector": lambda: ProjectorCore(ProjectorSettings()),
    "tracker": lambda: TrackerCore(TrackerSettings()),
}


def later(message: Message) -> bytes:
    """The bytes of a later version: a field more in each message, those within it and in its lists too."""
    new = type(message)()
    new.CopyFrom(message)

    def add(one: Message) -> None:
        for field, value in one.ListFields():
            if field.message_type is None or field.message_type.GetOptions().map_entry:
                continue
            for each in value if field.is_repeated else [value]:
                add(each)
        one.MergeFromString(LATER)

    add(new)
    return encode(new)


def versions_of_later(traffic: list[Envelope]) -> dict[str, str]:
    """What a later publisher calls the models and sets of `traffic`: what it adds is content too."""
    names = dict[str, str]()
    for model in (one.message for one in traffic if isinstance(one.message, RegionModel)):
        plain = RegionModel.FromString(later(model))
        plain.ClearField("version")
        plain.panoramas = zlib.decompress(plain.panoramas)
        names[model.version] = hashlib.sha256(plain.SerializeToString(deterministic=True)).hexdigest()
    for each in (one.message for one in traffic if isinstance(one.message, ModelSet)):
        names[each.version] = set_version(each.map_version, [names[e.version] for e in each.entries])
    return names


def renamed(payload: bytes, names: dict[str, str]) -> bytes:
    """With other versions; they are text of one length."""
    for name, other in names.items():
        payload = payload.replace(name.encode(), other.encode())
    return payload


def published(core: Core, received: list[Envelope], payload: Callable[[Message], bytes]) -> Iterator[bytes]:
    """What a core answers to messages that come as these bytes; not what it hands on unread, as stamps."""
    answers = list[Envelope]()
    for one in received:
        message = decode(one.channel, payload(one.message), encoding(one.channel))
        answers += core.handle(Envelope(one.channel, one.address, message))
    for each in [*answers, *core.finish()]:
        each.message.DiscardUnknownFields()
        yield encode(each.message)


@pytest.fixture(scope="module")
def traffic() -> list[Envelope]:
    return [record.envelope for record in read(DEPOT)]


@pytest.mark.parametrize("service", CORES)
def test_fields_of_a_later_version_change_no_answer(service: str, traffic: list[Envelope]) -> None:
    core, other = CORES[service](), CORES[service]()
    received = [one for one in traffic if one.channel in core.inputs]
    assert all(LATER in later(one.message) for one in received)
    today = list(published(core, received, encode))
    assert len(today) >= 20
    names = versions_of_later(traffic)
    answers = list(published(other, received, lambda message: renamed(later(message), names)))
    back = {new: old for old, new in names.items()}
    assert [renamed(answer, back) for answer in answers] == today
    condition = other.condition()
    for new, old in back.items():
        condition = replace(condition, detail=condition.detail.replace(new[:12], old[:12]))
    assert condition == core.condition()


def test_an_unknown_status_counts_as_unspecified(traffic: list[Envelope]) -> None:
    def with_status(number: int) -> list[bytes]:
        def changed(message: Message) -> bytes:
            if isinstance(message, Hypotheses):
                message.status = number  # type: ignore[assignment]
            return encode(message)

        core = CORES["tracker"]()
        return list(published(core, [one for one in traffic if one.channel in core.inputs], changed))

    assert with_status(99) == with_status(Hypotheses.STATUS_UNSPECIFIED)
