"""A recording given to cores in lock-step: the second of two passes over it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import (
    HEADING,
    MODEL,
    MODEL_SET,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN_MOTION,
    SEARCH,
    SPACE,
    TRACKS,
)
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel, RegionSpace
from eigenscan.workbench.replay.casting import Instance
from eigenscan.workbench.replay.services import Service, published_by, received_by
from eigenscan.workbench.replay.survey import Survey

DISPENSABLE = (ODOMETRY, HEADING, RELOCATION, SCAN_MOTION, SEARCH, POSE, TRACKS)
"""Optional inputs of a service."""


class Side(Enum):
    """Origin of an event."""

    RECEIVED = "heard"
    RECORDED = "recorded"
    REPLAYED = "replayed"


@dataclass(frozen=True)
class Event:
    """A message that cores received, that they once published, or publish now; `time` is a log time, ns."""

    side: Side
    time: int
    envelope: Envelope


def play(
    survey: Survey,
    services: tuple[Service, ...],
    instances: Sequence[Instance],
    models: Sequence[Envelope] = (),
    moved: Callable[[int], None] = lambda _time: None,
) -> Iterator[Event]:
    """All events, in order of the recording's log time; `moved` is called with it.

    The first map and its models come first, because a recorder may receive them late; `models` replace all
    that were recorded. Each answer follows its input. Raises UsageError if the cores lack an input.
    """
    published = published_by(services)
    received = received_by(instances, published)
    _check(survey, services)
    loop = Loopback(instances)
    yield from _replayed(survey.begin, loop.start())
    early = {key: one for key, one in _first_set(survey).items() if one.channel in received}
    first = models or early.values()
    wanted = [envelope for envelope in first if envelope.channel in received]
    for envelope in sorted(wanted, key=lambda one: received.index(one.channel)):
        yield Event(Side.RECEIVED, survey.begin, envelope)
        yield from _replayed(survey.begin, loop.receive(envelope))
    _check_ready(survey, instances)
    theirs, own = {channel.name for channel in published}, {channel.name for channel in received}
    for record in read(survey.path):
        envelope = record.envelope
        moved(record.log_time)
        if envelope.channel.name in theirs:
            yield Event(Side.RECORDED, record.log_time, envelope)
        elif envelope.channel.name in own and not _is_early(envelope, early, models):
            yield Event(Side.RECEIVED, record.log_time, envelope)
            yield from _replayed(record.log_time, loop.receive(envelope))
    yield from _replayed(survey.end, loop.finish())


def _first_set(survey: Survey) -> dict[str, Envelope]:
    """The first message of each latched key, without models of a later set: a projector would drop them."""
    announced = next((one for one in survey.latched.values() if one.channel is MODEL_SET), None)
    if announced is None:
        return survey.latched
    wanted = {entry.version for entry in announced.open(ModelSet).entries}

    def is_later(one: Envelope) -> bool:
        if one.channel is MODEL:
            return one.open(RegionModel).version not in wanted
        return one.channel is SPACE and one.open(RegionSpace).model_version not in wanted

    return {key: one for key, one in survey.latched.items() if not is_later(one)}


def _is_early(envelope: Envelope, early: dict[str, Envelope], models: Sequence[Envelope]) -> bool:
    """Whether the cores have it from the start: the first of a latched key, or replaced by `models`."""
    return envelope.channel.qos.latched and (bool(models) or early.pop(envelope.key, None) is not None)


def _replayed(time: int, published: Iterable[Envelope]) -> Iterator[Event]:
    return (Event(Side.REPLAYED, time, envelope) for envelope in published)


def _check(survey: Survey, services: tuple[Service, ...]) -> None:
    """Raises UsageError if the recording lacks an input that the first service needs."""
    first = services[0]
    for channel in first.inputs:
        needed = not channel.qos.latched and channel not in DISPENSABLE
        if needed and not survey.counts[channel]:
            raise UsageError(
                f"{survey.path}: holds no {channel.name}, an input of {first.name}: {survey.lacking}"
            )


def _check_ready(survey: Survey, instances: Sequence[Instance]) -> None:
    for instance in instances:
        if MODEL not in instance.inputs:
            continue
        condition = instance.condition()
        if condition.status == Health.STATUS_WAITING:
            raise UsageError(
                f"{survey.path}: {instance.service.name} cannot be replayed: {condition.detail}: "
                "give --model FOLDER, or record with the mapbuilder running"
            )
