"""Bad input that a service must survive: bytes that are no message, other schemas, bad numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass

from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import encode, encoding
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from google.protobuf.message import Message

GARBAGE = b"\xff\xff\xff\xff\x07 no message at all"
LATER_NS = 1_000_000


@dataclass(frozen=True)
class Bad:
    """One bad sample; `payload` None is a deletion."""

    about: str
    key: str
    payload: bytes | None
    encoding: str
    undecodable: bool = False
    """Whether the service has to count it so."""


def bad_samples(newest: Iterable[Envelope]) -> Iterator[Bad]:
    """Bad samples made from the newest good message of each key."""
    for good in newest:
        key, declared = good.key, encoding(good.channel)
        payload = encode(good.message)
        yield Bad("bytes that are no message", key, GARBAGE, declared, undecodable=True)
        other = declared.replace(good.channel.schema_name, "eigenscan.Nothing")
        yield Bad("another schema", key, payload, other, undecodable=True)
        later = f"{declared.rpartition('/')[0]}/99"
        yield Bad("another contract version", key, payload, later, undecodable=True)
        yield Bad("a deletion", key, None, declared)
        yield Bad("an empty message", key, b"", declared)
        for about, message in _senseless(good.message):
            yield Bad(about, key, encode(message), declared)


def _senseless(good: Message) -> Iterator[tuple[str, Message]]:
    if isinstance(good, RawScan | Scan):
        yield from _senseless_scans(good)
    elif isinstance(good, Hypotheses):
        yield from _senseless_hypotheses(good)
    elif isinstance(good, Odometry):
        nowhere = deepcopy(good)
        nowhere.pose.position.x = math.nan
        yield "odometry at NaN", nowhere


def _senseless_scans(good: RawScan | Scan) -> Iterator[tuple[str, Message]]:
    count = len(good.ranges)
    yield "a scan of NaN alone", _scan(good, 1, ranges=[math.nan] * count)
    yield "a scan without a return", _scan(good, 2, ranges=[math.inf] * count)
    yield "a scan without beams", _scan(good, 3, ranges=[])
    yield "an angle increment of 0", _scan(good, 4, angle_increment=0.0)
    yield "an angle that is NaN", _scan(good, 5, angle_min=math.nan)
    nowhere = _scan(good, 6)
    nowhere.mount.x = math.nan
    yield "a mount at NaN", nowhere
    yield "negative ranges", _scan(good, 7, ranges=[-1.0] * count)
    yield "a stamp of a minute ago", _scan(good, -60_000)


def _scan(
    good: RawScan | Scan, later: int, ranges: list[float] | None = None, **fields: float
) -> RawScan | Scan:
    """The scan with other fields, `later` ms after it."""
    other = deepcopy(good)
    other.timestamp.CopyFrom(stamp(nanoseconds(good.timestamp) + later * LATER_NS))
    for name, value in fields.items():
        setattr(other, name, value)
    if ranges is not None:
        other.ranges[:] = ranges
    return other


def _senseless_hypotheses(good: Hypotheses) -> Iterator[tuple[str, Message]]:
    def other(later: int) -> Hypotheses:
        message = deepcopy(good)
        message.timestamp.CopyFrom(stamp(nanoseconds(good.timestamp) + later * LATER_NS))
        return message

    nowhere, sure, old, none = other(1), other(2), other(-60_000), other(3)
    for hypothesis in nowhere.hypotheses:
        hypothesis.pose.x = math.nan
    for hypothesis in sure.hypotheses:
        hypothesis.covariance.xx = hypothesis.covariance.yy = -1.0
        hypothesis.log_likelihood = math.inf
    none.ClearField("hypotheses")
    none.status = Hypotheses.STATUS_UNUSABLE_SCAN
    yield "hypotheses at NaN", nowhere
    yield "a negative covariance and an infinite likelihood", sure
    yield "a list that is empty", none
    yield "a stamp of a minute ago", old
