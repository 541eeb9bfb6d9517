"""Compares recorded and replayed messages: matched by key and stamp, judged by bytes, then by fields."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import encode
from eigenscan.workbench.replay.fields import Difference, differences
from eigenscan.workbench.replay.playing import Event, Side

LEAST = 10
"""Compared messages that a replay needs, to prove anything."""


@dataclass(frozen=True)
class Terms:
    """Rules for equality."""

    tolerant: bool = False
    ignored: frozenset[str] = frozenset()
    """Fields, such as `scan.sequence`."""
    unjudged: Mapping[Channel, str] = field(default_factory=dict)
    """Channels that are counted only, and why."""
    least: int = LEAST


@dataclass
class Counts:
    """Messages of one channel."""

    recorded: int = 0
    replayed: int = 0
    same: int = 0
    within: int = 0
    """Not the same bytes, but the same within tolerances and but for ignored fields."""
    different: int = 0
    missing: int = 0
    """Recorded, and not published again."""
    extra: int = 0
    """Published now, but not recorded."""
    outside: int = 0
    """Published now, with a stamp outside the recorded ones, because the recorder was not running."""

    @property
    def compared(self) -> int:
        """Messages that both sides report."""
        return self.same + self.within + self.different

    @property
    def is_equal(self) -> bool:
        """Whether nothing speaks against it."""
        return not (self.different or self.missing or self.extra)


@dataclass(frozen=True)
class Finding:
    """One message that is not as recorded."""

    stamp: int
    channel: Channel
    key: str
    fields: tuple[Difference, ...]


class _Order:
    """The stamps of one key on both sides, from the first on that is not the same."""

    def __init__(self) -> None:
        self._same = 0
        self._rest: dict[Side, deque[int]] = {Side.RECORDED: deque(), Side.REPLAYED: deque()}

    def take(self, side: Side, stamp: int) -> None:
        """Takes the next stamp of a side."""
        self._rest[side].append(stamp)
        recorded, replayed = self._rest.values()
        while recorded and replayed and recorded[0] == replayed[0]:
            recorded.popleft()
            replayed.popleft()
            self._same += 1

    @property
    def difference(self) -> tuple[int, int, int] | None:
        """Place, recorded and replayed stamp where the same stamps first come in another order."""
        recorded, replayed = self._rest.values()
        if not recorded or sorted(recorded) != sorted(replayed):  # those of one side are counted already
            return None
        return self._same, recorded[0], replayed[0]


class Comparison:
    """Takes events in the order of each side; holds only those that wait for their counterpart."""

    def __init__(
        self, channels: Sequence[Channel], spans: Mapping[str, tuple[int, int]], terms: Terms
    ) -> None:
        """`spans` are the least and greatest recorded stamp, ns, of each key."""
        self.terms = terms
        self.counts = {channel: Counts() for channel in channels}
        self._channels, self._spans = list(channels), spans
        self._waiting: dict[tuple[str, int], deque[Event]] = {}
        self._orders: dict[str, _Order] = defaultdict(_Order)
        self._first: Finding | None = None

    def take(self, event: Event) -> None:
        """Takes a recorded or replayed message; ignores inputs."""
        if event.side is Side.RECEIVED:
            return
        envelope, count = event.envelope, self.counts[event.envelope.channel]
        count.recorded += event.side is Side.RECORDED
        count.replayed += event.side is Side.REPLAYED
        key, stamp = envelope.key, envelope.stamp
        waiting = self._waiting.setdefault((key, stamp), deque())
        if waiting and waiting[0].side is not event.side:
            pair = {waiting[0].side: waiting.popleft().envelope, event.side: envelope}
            self._judge(key, stamp, pair[Side.RECORDED], pair[Side.REPLAYED])
        else:
            waiting.append(event)
        if not waiting:
            del self._waiting[key, stamp]
        if not self._is_outside(key, stamp):
            self._orders[key].take(event.side, stamp)

    def finish(self) -> None:
        """Judges messages without a counterpart, and the order. Call it once, at the end."""
        for (key, stamp), waiting in self._waiting.items():
            for event in waiting:
                self._judge_alone(key, stamp, event)
        self._waiting.clear()
        for key, order in self._orders.items():
            self._judge_order(key, order)

    @property
    def first(self) -> Finding | None:
        """The difference with the earliest stamp; of one stamp, that of the channel nearest to the sensor."""
        return self._first

    @property
    def judged(self) -> dict[Channel, Counts]:
        """The counts that decide."""
        return {
            channel: count for channel, count in self.counts.items() if channel not in self.terms.unjudged
        }

    @property
    def problems(self) -> list[str]:
        """Differences, and reasons that this shows nothing; empty if all is equal."""
        judged = self.judged
        compared = sum(count.compared for count in judged.values())
        lone = sum(count.missing + count.extra for count in judged.values())
        found = []
        if compared + lone < self.terms.least:
            found.append(
                f"only {compared} messages to compare, fewer than {self.terms.least}: proves nothing"
            )
        for channel, count in judged.items():
            if not count.is_equal:
                counts = f"{count.different} different, {count.missing} missing, {count.extra} too many"
                found.append(f"{channel.name}: {counts}")
            elif count.outside > count.compared:
                published = count.compared + count.outside
                found.append(
                    f"{channel.name}: only {count.compared} of {published} messages are in the recording"
                )
        return found

    def _is_outside(self, key: str, stamp: int) -> bool:
        first, last = self._spans.get(key, (stamp + 1, stamp))
        return not first <= stamp <= last

    def _judge(self, key: str, stamp: int, recorded: Envelope, replayed: Envelope) -> None:
        channel = recorded.channel
        count = self.counts[channel]
        before, now = encode(recorded.message), encode(replayed.message)
        if before == now:
            count.same += 1
            return
        found = list(differences(recorded.message, replayed.message, tolerant=self.terms.tolerant))
        if not found and not self.terms.tolerant:
            found = [Difference("(bytes)", before.hex(), now.hex())]
        found = [one for one in found if not self._is_ignored(channel, one)]
        if not found:
            count.within += 1
            return
        count.different += 1
        self._note(Finding(stamp, channel, key, tuple(found)))

    def _judge_alone(self, key: str, stamp: int, event: Event) -> None:
        channel = event.envelope.channel
        count = self.counts[channel]
        if event.side is Side.RECORDED:
            count.missing += 1
            found = Difference("(message)", "published", "missing")
        elif self._is_outside(key, stamp):
            count.outside += 1
            return
        else:
            count.extra += 1
            found = Difference("(message)", "missing", "published")
        self._note(Finding(stamp, channel, key, (found,)))

    def _judge_order(self, key: str, order: _Order) -> None:
        if order.difference is None:
            return
        place, recorded, replayed = order.difference
        channel = next(channel for channel in self._channels if channel.parse(key))
        self.counts[channel].different += 1
        found = Difference(f"(order)[{place}]", recorded, replayed)
        self._note(Finding(recorded, channel, key, (found,)))

    def _is_ignored(self, channel: Channel, one: Difference) -> bool:
        name = f"{channel.name}.{one.name}"
        return any(name == field or name.startswith(f"{field}.") for field in self.terms.ignored)

    def _note(self, finding: Finding) -> None:
        if finding.channel not in self.terms.unjudged and (
            self._first is None or self._rank(finding) < self._rank(self._first)
        ):
            self._first = finding

    def _rank(self, finding: Finding) -> tuple[int, int, str]:
        return finding.stamp, self._channels.index(finding.channel), finding.key
