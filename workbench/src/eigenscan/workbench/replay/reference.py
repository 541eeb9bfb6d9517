"""References beside recordings: accepted answers of the cores."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import chain
from pathlib import Path

from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.recording import RecordingWriter, read, read_metadata
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.whole import whole
from eigenscan.workbench.replay.playing import Event, Side
from eigenscan.workbench.replay.services import CHOICES, PARTS

SUFFIX = ".reference.mcap"
_RECORD = "reference"


@dataclass(frozen=True)
class Reference:
    """A reference that fits its recording."""

    path: Path
    spans: dict[str, tuple[int, int]]
    """Least and greatest stamp, ns, by key."""
    made_with: str
    choices: tuple[str, ...]
    """The services whose messages it holds, as values of `--service`."""

    def words(self, side: Side, channels: Sequence[Channel]) -> Iterator[Event]:
        """Its messages on `channels`, as events of `side`."""
        for record in read(self.path):
            if record.envelope.channel in channels:
                yield Event(side, record.log_time, record.envelope)


def path_beside(recording: Path) -> Path:
    """Path of a recording's reference."""
    return recording.with_name(recording.stem + SUFFIX)


def open_beside(recording: Path) -> Reference | None:
    """The reference of a recording, if there is one.

    Raises UsageError for one of another recording, RecordingError for a damaged one.
    """
    path = path_beside(recording)
    if not path.exists():
        return None
    entry = read_metadata(path).get(_RECORD, {})
    if entry.get("recording_sha256") != _digest(recording):
        raise UsageError(f"{path}: is of another recording than {recording.name}: --update makes it again")
    choices = tuple(name for name in entry.get("choices", "").split() if name in CHOICES)
    spans: dict[str, tuple[int, int]] = {}
    for record in read(path):
        key, stamp = record.envelope.key, record.envelope.stamp
        first, last = spans.get(key, (stamp, stamp))
        spans[key] = min(first, stamp), max(last, stamp)
    return Reference(path, spans, entry.get("made_with", ""), choices)


def write_beside(recording: Path, parts: Mapping[str, Iterable[Event]]) -> int:
    """Makes the published messages of each choice of services the reference; returns their number.

    The old one stays until all is written.
    """
    metadata = {
        _RECORD: {
            "recording_sha256": _digest(recording),
            "choices": " ".join(parts),
            "made_with": made_with(),
        }
    }
    count = 0
    with whole(path_beside(recording)) as fresh, RecordingWriter(fresh, metadata) as writer:
        for event in chain.from_iterable(parts.values()):
            if event.side is Side.REPLAYED:
                writer.write(event.envelope, event.time)
                count += 1
    return count


def made_with() -> str:
    """Versions and machine that bytes depend on, in words."""
    own = [f"{service.name} {version(f'eigenscan-{service.name}')}" for service in PARTS]
    return ", ".join([*own, f"numpy {version('numpy')}", platform.machine()])


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
