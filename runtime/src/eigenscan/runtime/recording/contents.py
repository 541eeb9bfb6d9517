"""Summarises a recording: keys, counts and times. Reads only the index, if there is one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from eigenscan.runtime.recording.files import is_indexed, messages, opened, parts
from eigenscan.schemas.channels import Channel, find
from mcap.reader import make_reader

STEP_NS = 1_000_000_000
"""Log times in a file that go back by more show a clock that was set back, ns."""
LAST = 2**64 - 1
"""The last log time that an MCAP can hold."""


@dataclass
class Contents:
    """Keys and time span of a recording, and the number of messages outside the contract."""

    begin: int = LAST
    end: int = 0
    """Log times of the first and the last message, ns since the epoch. Without a message, begin > end."""
    counts: Counter[str] = field(default_factory=Counter)
    """Messages by key."""
    foreign: Counter[str] = field(default_factory=Counter)
    """Messages by topic, for topics that are no keys of the contract."""
    complete: bool = True
    """Whether the writer closed every file."""

    @property
    def messages(self) -> int:
        """Number of all messages."""
        return self.counts.total() + self.foreign.total()

    @property
    def sites(self) -> list[str]:
        """The sites of its keys."""
        return sorted({found[1]["site"] for key in self.counts if (found := find(key))})

    def keys_of(self, channel: Channel) -> list[str]:
        """The keys of one channel."""
        return [key for key in self.counts if channel.parse(key)]

    def stretch(self, begin_s: float, end_s: float | None) -> tuple[int, int]:
        """Log times, ns, of two times in s from the start; the end is at most the recording's."""
        begin = self.begin + int(begin_s * 1e9)
        return begin, self.end if end_s is None else min(self.end, self.begin + int(end_s * 1e9))

    def add(self, topic: str, count: int) -> None:
        """Counts messages on a topic."""
        (self.counts if find(topic) else self.foreign)[topic] += count

    def span(self, begin: int, end: int) -> None:
        """Widens the span."""
        self.begin = min(self.begin, begin)
        self.end = max(self.end, end)


def contents(path: Path) -> Contents:
    """Contents of a file, or of all files in a folder. A file without an index is read through.

    Raises RecordingError if a file is missing, no MCAP, or damaged.
    """
    found = Contents()
    for part in parts(path):
        _add(found, part)
    return found


def _add(found: Contents, path: Path) -> None:
    with opened(path) as file:
        if not is_indexed(file):
            found.complete = False
        else:
            summary = make_reader(file).get_summary()
            statistics = summary.statistics if summary else None
            if summary and statistics:
                for number, count in statistics.channel_message_counts.items():
                    found.add(summary.channels[number].topic, count)
                if statistics.message_count:
                    found.span(statistics.message_start_time, statistics.message_end_time)
                return
        file.seek(0)
        for _, channel, message in messages(file):
            found.add(channel.topic, 1)
            found.span(message.log_time, message.log_time)


def is_complete(path: Path) -> bool:
    """Whether the writer closed the file. Raises RecordingError if it cannot be read at all."""
    for part in parts(path):
        with opened(part) as file:
            if not is_indexed(file):
                return False
            make_reader(file).get_summary()
    return True


def clock_set_back(path: Path) -> int:
    """Log time, ns, at which the recorder's clock was first set back within a file; 0: never.

    Reads only the index, as a file without one is read in order of arrival. Raises RecordingError.
    """
    for part in parts(path):
        with opened(part) as file:
            summary = make_reader(file).get_summary() if is_indexed(file) else None
        chunks = [index for index in summary.chunk_indexes if index.message_end_time] if summary else []
        newest = 0
        for index in sorted(chunks, key=lambda index: index.chunk_start_offset):
            if index.message_start_time < newest - STEP_NS:
                return max(newest, index.message_end_time)
            newest = max(newest, index.message_end_time)
    return 0


def message_count(path: Path) -> int | None:
    """Number of messages, from the index; None without an index, because the writer was killed.

    Raises RecordingError if the file is missing, no MCAP, or damaged.
    """
    return contents(path).messages if is_complete(path) else None


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Metadata records by name, from the file or a folder's first file. Raises RecordingError."""
    with opened(parts(path)[0]) as file:
        return {entry.name: dict(entry.metadata) for entry in make_reader(file).iter_metadata()}


def closed_span(path: Path) -> tuple[int, int] | None:
    """Log times, ns, of the first and last message of a closed file; None if its writer did not close it.

    Reads only the index. Raises RecordingError if the file is missing, no MCAP, or damaged.
    """
    with opened(path) as file:
        if not is_indexed(file):
            return None
        summary = make_reader(file).get_summary()
        statistics = summary.statistics if summary else None
        return (statistics.message_start_time, statistics.message_end_time) if statistics else (0, 0)


def first_time(path: Path) -> int | None:
    """Log time, ns, of the first message; None if no chunk is whole yet. Reads only that chunk.

    Raises RecordingError if the file is missing, no MCAP, or damaged.
    """
    with opened(path) as file:
        return next((message.log_time for _, _, message in messages(file)), None)
