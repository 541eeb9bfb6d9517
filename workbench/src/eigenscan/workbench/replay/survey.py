"""Summarises a recording for a replay: the first of two passes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.health import has_fallen
from eigenscan.runtime.recording import (
    Record,
    clock_set_back,
    contents,
    is_complete,
    parts,
    read,
    read_metadata,
)
from eigenscan.schemas.channels import HEALTH, HYPOTHESES, SCAN, TRACKS, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.group import holds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import Tracks
from eigenscan.workbench.replay.services import PARTS, published_by


@dataclass
class Reported:
    """An instance's entries in its recorded health."""

    is_known: bool = False
    version: str = ""
    settings: str = ""
    settings_changed: bool = False
    restarts: int = 0
    counters: dict[str, int] = field(default_factory=dict)
    grown: Counter[str] = field(default_factory=Counter)
    """How much each counter grew from its first word in the recording on."""

    def receive(self, health: Health) -> None:
        """Takes its next word."""
        received = dict(health.counters)
        self.restarts += has_fallen(self.counters, received)
        if self.is_known:  # not its first word: that may tell of the time before the recording
            self.grown.update({name: max(n - self.counters.get(name, 0), 0) for name, n in received.items()})
        self.is_known, self.version, self.counters = True, health.package_version, received
        self.settings = self.settings or health.settings
        self.settings_changed |= health.settings not in ("", self.settings)

    @property
    def lost(self) -> dict[str, int]:
        """Messages by channel that did not fit into its inbox."""
        start = "dropped_"
        return {
            name.removeprefix(start): count
            for name, count in self.counters.items()
            if name.startswith(start) and count and not name.endswith("foreign_key")
        }


@dataclass
class Survey:
    """A recording at a glance."""

    path: Path
    complete: bool
    settings: dict[str, str]
    """Settings of services, JSON by name, if the file holds them."""
    set_back: int = 0
    """Log time, ns, at which the recorder's clock was set back; 0: never."""
    begin: int = 0
    end: int = 0
    """Log times of its first and last message, ns."""
    counts: Counter[Channel] = field(default_factory=Counter)
    of_robots: Counter[tuple[Channel, str]] = field(default_factory=Counter)
    """Messages by channel and robot."""
    latched: dict[str, Envelope] = field(default_factory=dict)
    """The first message of each latched key."""
    spans: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Least and greatest stamp, ns, of each key that a service speaks on."""
    sites: set[str] = field(default_factory=set)
    projectors: dict[str, set[str]] = field(default_factory=dict)
    """Robots of each projector, from its messages."""
    reported: dict[tuple[str, str], Reported] = field(default_factory=dict)
    """By service and instance."""
    remembered: dict[str, str] = field(default_factory=dict)
    """By service: the sign that it ran before the recording began."""

    @property
    def seconds(self) -> float:
        """Seconds from the first message to the last."""
        return (self.end - self.begin) * 1e-9

    def held(self, channel: Channel, robots: str) -> int:
        """Messages on a channel for a group of robots."""
        return sum(n for (of, robot), n in self.of_robots.items() if of is channel and holds(robots, robot))

    @property
    def lacking(self) -> str:
        """The fix where a channel is not in the file."""
        if self.complete:
            return "record it as well"
        return f"the file breaks off after {self.seconds:.1f} s; else record it as well"

    def take(self, record: Record) -> None:
        """Notes the next message."""
        envelope = record.envelope
        channel, key = envelope.channel, envelope.key
        self.sites.add(envelope.address["site"])
        self.begin = self.begin or record.log_time
        self.end = max(self.end, record.log_time)
        if channel is HEALTH:
            health = envelope.open(Health)
            self.reported.setdefault((health.service, health.instance), Reported()).receive(health)
        if channel.qos.latched:
            self.latched.setdefault(key, envelope)
        if channel in _PUBLISHED:
            stamp = envelope.stamp
            first, last = self.spans.get(key, (stamp, stamp))
            self.spans[key] = min(first, stamp), max(last, stamp)
            self._look_back(envelope)
        if channel is HYPOTHESES:
            self.projectors.setdefault(envelope.address["projector"], set()).add(envelope.address["robot"])
        self.counts[channel] += 1
        if "robot" in envelope.address:
            self.of_robots[channel, envelope.address["robot"]] += 1

    def _look_back(self, envelope: Envelope) -> None:
        """Checks whether the first message on a key depends on messages before the recording."""
        if self.counts[envelope.channel]:
            return
        if envelope.channel is SCAN and (sequence := envelope.open(Scan).sequence):
            self.remembered["scan-ingest"] = f"its first scan here is its number {sequence}"
        if envelope.channel is HYPOTHESES and envelope.open(Hypotheses).search == SEARCH_LOCAL:
            self.remembered["projector"] = "its first list here is of a local fit"
        if envelope.channel is TRACKS:
            age = max((track.age for track in envelope.open(Tracks).tracks), default=0.0)
            if age > 0:
                self.remembered["tracker"] = f"its first track here is {age:.1f} s old"


_PUBLISHED = published_by(PARTS)


def _refuse_copies(path: Path) -> None:
    """Raises UsageError where two files of a folder are one: half of the messages would be missing."""
    seen: dict[tuple[object, ...], Path] = {}
    for part in parts(path) if path.is_dir() else ():
        held = contents(part)
        first = seen.setdefault((held.begin, held.end, *sorted(held.counts.items())), part)
        if held.messages and first is not part:
            raise UsageError(f"{path}: {first.name} and {part.name} hold the same messages: leave one out")


def survey(path: Path) -> Survey:
    """Reads `path` once. Raises RecordingError, or UsageError if it holds nothing of the contract."""
    _refuse_copies(path)
    complete = is_complete(path)
    metadata = read_metadata(path) if complete else {}
    settings = {name: entry["settings"] for name, entry in metadata.items() if "settings" in entry}
    found = Survey(path, complete, settings, clock_set_back(path))
    for record in read(path):
        found.take(record)
    if found.set_back:  # both rest on the order of messages
        found.remembered.clear()
        for reported in found.reported.values():
            reported.restarts = 0
    if not found.counts:
        why = "give a file that the recorder wrote" if complete else "it ends before the first whole chunk"
        raise UsageError(f"{path}: holds no message of ours: {why}")
    return found
