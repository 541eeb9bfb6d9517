"""The interface of every log: envelopes of raw scans and odometry, in order of their stamps."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from eigenscan.geometry.pose import to_message, to_pose3
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs.set_back import SetBack
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import ArrayLike, NDArray

ODOMETRY_FRAME = "odom"
BASE_FRAME = "base_link"

RECORDER_LAG_NS = 2_000_000_000
"""Messages of a recording are out of the order of their stamps by up to this."""


class LogError(ValueError):
    """A log that cannot be read; the message names the file, what is wrong and the fix."""


@dataclass(frozen=True)
class Mount:
    """Mount of a lidar: m ahead of the base's origin, m to the left, rad counter-clockwise."""

    x: float
    y: float
    yaw: float
    upside_down: bool = False


@dataclass(frozen=True)
class LogOptions:
    """How a log is to be read; None and empty: found out from the log."""

    site: str = DEFAULT_SITE
    robot: str = DEFAULT_ROBOT
    lidars: tuple[str, ...] = ()  # topics, or lidar names, to take
    odometry: str | None = None  # topic
    base_frame: str | None = None
    mounts: Mapping[str, Mount] = field(default_factory=dict)  # by lidar name, instead of the log's


class Log(Protocol):
    """A log, opened. Envelopes can be iterated more than once."""

    path: Path
    format: str
    counters: Counter[str]  # rejected while iterating, by reason
    logged: dict[int, int]  # ns, stamp as logged of each scan that was given another one, by that one
    damage: str  # after iterating: what was not read of a recording, and what saves it; empty: all was

    @property
    def progress(self) -> float:
        """0..1, while iterating."""
        ...

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp; at equal stamps odometry comes first.

        Stamps of one key increase. If a log's do not, they are repaired (see `stamps` and `set_back`). Raises
        LogError if the log has no scan.
        """
        ...


def raw_scan(options: LogOptions, lidar: str, time: int, mount: ArrayLike, **fields: Any) -> Envelope:
    """Envelope of a RawScan; `mount` (3,) is the sensor in the base frame, `time` in ns."""
    message = RawScan(timestamp=stamp(time), mount=to_message(mount), **fields)
    place(options, lidar, message)
    return Envelope(SCAN_RAW, {"site": options.site, "robot": options.robot, "lidar": lidar}, message)


def single(ranges: NDArray[np.float64]) -> list[float]:
    """Ranges as a message holds them; a range above all that it can hold is infinite, so no return."""
    with np.errstate(over="ignore"):
        held: list[float] = ranges.astype(np.float32).tolist()
    return held


def place(options: LogOptions, lidar: str, message: RawScan) -> None:
    """Gives `message` the mount that the options state for its lidar."""
    given = options.mounts.get(lidar)
    if given is not None:
        message.mount.CopyFrom(to_message((given.x, given.y, given.yaw)))
        message.upside_down = given.upside_down


def odometry(options: LogOptions, time: int, pose: ArrayLike, **fields: Any) -> Envelope:
    """Envelope of an Odometry; `pose` (3,) is the base in the odometry frame, `time` in ns."""
    message = Odometry(
        timestamp=stamp(time),
        frame_id=ODOMETRY_FRAME,
        body_frame_id=options.base_frame or BASE_FRAME,
        pose=to_pose3(pose),
        **fields,
    )
    return Envelope(ODOMETRY, {"site": options.site, "robot": options.robot}, message)


def in_order(
    envelopes: Iterable[Envelope], horizon: int, counters: Counter[str], logged: dict[int, int]
) -> Iterator[Envelope]:
    """Sorts envelopes that are out of order by up to `horizon` ns; at equal stamps odometry comes first.

    After a clock was set back, time goes on (see `set_back`). Lone late ones, and repeated stamps of a key,
    are counted and left out.
    """
    waiting: list[tuple[int, bool, int, Envelope]] = []
    newest = 0
    last: dict[str, int] = {}

    def release() -> Iterator[Envelope]:
        time, _, _, envelope = heapq.heappop(waiting)
        key = envelope.key
        before = last.get(key)
        if before is None or time > before:
            last[key] = time
            yield envelope
        else:
            reason = "duplicate_stamp" if time == before else "out_of_order"
            counters[f"{envelope.channel.name}_{reason}"] += 1

    for number, envelope in enumerate(SetBack(horizon, counters, logged).going_on(envelopes)):
        time = envelope.stamp
        newest = max(newest, time)
        heapq.heappush(waiting, (time, envelope.channel is not ODOMETRY, number, envelope))
        while waiting[0][0] < newest - horizon:
            yield from release()
    while waiting:
        yield from release()
