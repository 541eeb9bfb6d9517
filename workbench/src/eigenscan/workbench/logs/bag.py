"""The interface of a bag for the ROS importer, for any container."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import zstandard
from eigenscan.runtime.recording.files import refuse_bomb

LASER_SCAN = "sensor_msgs/msg/LaserScan"
MULTI_ECHO = "sensor_msgs/msg/MultiEchoLaserScan"
ODOMETRY_MESSAGE = "nav_msgs/msg/Odometry"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
KINDS = frozenset({LASER_SCAN, MULTI_ECHO, ODOMETRY_MESSAGE, TRANSFORMS})

Decoder = Callable[[bytes], Any]


@dataclass(frozen=True)
class BagMessage:
    """One message as recorded; `message` has the fields of its ROS type."""

    topic: str
    time: int  # ns, when it was recorded
    message: Any


class Bag(Protocol):
    """A bag, opened."""

    path: Path
    format: str
    counters: Counter[str]

    @property
    def progress(self) -> float:
        """0..1, while iterating."""
        ...

    def topics(self) -> dict[str, str]:
        """Type of each topic; only those of KINDS can be read. Raises LogError if the file is no bag."""
        ...

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages of `topics`, about in order of recording, as far as the bag can be read."""
        ...


def kind_of(name: object) -> str:
    """A type's name as ROS 2 writes it; the old tf/tfMessage is the same as tf2_msgs/TFMessage."""
    if not isinstance(name, str):  # SQLite gives what damage made of it
        return ""
    package, _, message = name.partition("/")
    message = message.removeprefix("msg/")
    return TRANSFORMS if package == "tf" else f"{package}/msg/{message}"


@cache
def decoder(kind: str, ros1: bool) -> Decoder:
    """Turns the bytes of a message of one of KINDS into an object; of several echoes the first counts."""
    if kind == MULTI_ECHO:
        return _first_echoes(_plain_decoder(kind, ros1))
    return _plain_decoder(kind, ros1)


def _first_echoes(decode: Decoder) -> Decoder:
    def decode_first(data: bytes) -> Any:
        message = decode(data)
        message.ranges = [echo.echoes[0] if len(echo.echoes) else math.inf for echo in message.ranges]
        return message

    return decode_first


def _plain_decoder(kind: str, ros1: bool) -> Decoder:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if ros1:
        store = get_typestore(Stores.ROS1_NOETIC)
        # the library's store leaves this one out
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
        return lambda data: store.deserialize_ros1(data, kind)
    store = get_typestore(Stores.ROS2_HUMBLE)
    return lambda data: store.deserialize_cdr(_inflated(data), kind)


def _inflated(data: bytes) -> bytes:
    """A message of ROS 2, whose first byte is 0 unless it was recorded with --compression-mode message."""
    if not data.startswith(zstandard.FRAME_HEADER):
        return data
    refuse_bomb(b"zstd", data, len(data), 0)
    return zstandard.decompress(data)


def decoded(
    counters: Counter[str], topic: str, time: int, data: bytes, decode: Decoder
) -> Iterator[BagMessage]:
    """Yields the message; if its bytes do not decode, counts it instead."""
    try:
        message = decode(data)
    except Exception:  # the library raises many errors for damaged bytes
        counters["undecodable_message"] += 1
        return
    yield BagMessage(topic, time, message)
