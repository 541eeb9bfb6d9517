"""Names, stamps and number of the robots in a playback."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.workbench.simulation.stage import Timed
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

SPREAD_NS = 1_000_000_000
"""Copies of a robot follow each other evenly within this, so that not all speak at once."""


@dataclass(frozen=True)
class Cast:
    """Names to play under; None: as recorded. Of `robots` copies of the one robot the first is r-001."""

    site: str | None = None
    robot: str | None = None
    robots: int = 0

    def messages(self, recorded: Iterable[Timed]) -> Iterator[Timed]:
        """The messages under their names, in order of time; a copy that follows has its stamps later, too."""
        if not self.robots:
            yield from (self._named(timed, self.robot) for timed in recorded)
            return
        later: list[tuple[int, int, int, Timed]] = []
        for number, timed in enumerate(recorded):
            while later and later[0][0] <= timed.time:
                yield self._copy(*heapq.heappop(later)[2:])
            yield self._copy(1, timed)
            for robot in range(2, self.robots + 1) if "robot" in timed.envelope.channel.fields else ():
                heapq.heappush(later, (timed.time + self._delay(robot), number, robot, timed))
        while later:
            yield self._copy(*heapq.heappop(later)[2:])

    def _delay(self, robot: int) -> int:
        return (robot - 1) * SPREAD_NS // self.robots

    def _copy(self, robot: int, timed: Timed) -> Timed:
        delay = self._delay(robot)
        published = self._named(Timed(timed.time + delay, timed.envelope), f"r-{robot:03d}")
        return Timed(published.time, shifted(published.envelope, delay)) if delay else published

    def _named(self, timed: Timed, robot: str | None) -> Timed:
        own = timed.envelope
        names = {"site": self.site, "robot": robot}
        known = {name: value for name, value in names.items() if value is not None and name in own.address}
        return (
            Timed(timed.time, Envelope(own.channel, {**own.address, **known}, own.message))
            if known
            else timed
        )


def shifted(envelope: Envelope, by: int) -> Envelope:
    """The envelope with all its stamps `by` ns later; unchanged without one, and for maps and models."""
    fields = envelope.message.DESCRIPTOR.fields_by_name
    if (
        envelope.channel.qos.latched
        or "timestamp" not in fields
        or not envelope.message.HasField("timestamp")
    ):
        return envelope
    message: Message = type(envelope.message)()
    message.CopyFrom(envelope.message)
    _shift(message, by)
    return Envelope(envelope.channel, envelope.address, message)


def _shift(message: Message, by: int) -> None:
    """A motion since another scan, or a scan's own motion, keeps its duration."""
    if isinstance(message, Timestamp):
        message.CopyFrom(stamp(max(nanoseconds(message) + by, 0)))
        return
    for field, value in message.ListFields():
        if field.message_type is None or field.message_type.GetOptions().map_entry:
            continue
        for each in [value] if isinstance(value, Message) else value:
            _shift(each, by)
