"""ROS 2 bags: a folder, one .db3 file, or MCAP, also with ROS 1 or Foxglove messages in it."""

from __future__ import annotations

import re
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

from eigenscan.geometry.gridmap import MOST_NESTED, nesting
from eigenscan.workbench.logs.bag import KINDS, BagMessage, Decoder, decoded, decoder, kind_of
from eigenscan.workbench.logs.foxglove import FOXGLOVE
from eigenscan.workbench.logs.log import RECORDER_LAG_NS, LogError
from eigenscan.workbench.logs.mcap_messages import Copies, McapFile

MOST_METADATA_BYTES = 300_000
"""A thousand topics."""
_REFUSED = (
    FileNotFoundError,
    AssertionError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    ArithmeticError,
    MemoryError,
    RecursionError,
)
"""Errors that the library raises for damaged files and metadata, besides its own."""


class Ros2Bag:
    """A bag of sqlite3 files, read by rosbags. Files that it refuses (cut, no metadata) are salvaged."""

    format = "ROS 2 bag"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counters: Counter[str] = Counter()
        self.progress = 0.0
        _check_metadata(path / "metadata.yaml")

    def topics(self) -> dict[str, str]:
        """Types by topic."""
        import apsw
        from rosbags.rosbag2 import Reader, ReaderError

        try:
            with Reader(self.path) as reader:
                found = {connection.topic: connection.msgtype for connection in reader.connections}
        except (*_REFUSED, ReaderError, apsw.Error):
            found = {topic: kind for file in self._files() for topic, kind in _tables(file).values()}
            if not found:
                raise LogError(f"{self.path}: holds no readable ROS 2 bag: record it again") from None
        return {topic: kind_of(kind) for topic, kind in found.items()}

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages by time of recording; salvaged ones, or if it was set back, in the order of the file."""
        for topic, kind, time, data in self._raw(topics):
            yield from decoded(self.counters, topic, time, data, decoder(kind_of(kind), ros1=False))

    def _raw(self, topics: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
        import apsw
        from rosbags.rosbag2 import Reader, ReaderError

        if self.path.is_dir() and not (self.path / "metadata.yaml").is_file():
            self.counters["no_metadata"] += 1
            yield from self._salvaged(topics)
            return
        if any(_goes_back(file) for file in self._files()):
            yield from self._salvaged(topics)
            return
        given = 0
        try:
            with Reader(self.path) as reader:
                wanted = [c for c in reader.connections if c.topic in topics]
                total = max(sum(c.msgcount for c in wanted), 1)
                for connection, time, data in reader.messages(wanted) if wanted else ():
                    given += 1
                    self.progress = min(given / total, 1.0)
                    yield connection.topic, connection.msgtype, time, data
        except (*_REFUSED, ReaderError, apsw.Error):
            self.counters["truncated_file"] += 1
            if not given:
                yield from self._salvaged(topics)

    def _salvaged(self, topics: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
        for file in self._files():
            try:
                yield from _salvage(file, topics)
            except sqlite3.Error:
                self.counters["truncated_file"] = 1

    def _files(self) -> list[Path]:
        return _parts(self.path, "*.db3")


def _parts(path: Path, *patterns: str) -> list[Path]:
    """Files of a bag, part 9 before part 10."""
    if not path.is_dir():
        return [path]
    files = [file for pattern in patterns for file in path.glob(pattern)]
    return sorted(files, key=lambda file: [int(n) for n in re.findall(r"\d+", file.name)])


def _query(path: Path, text: str) -> Iterator[tuple[Any, ...]]:
    """Rows. Raises sqlite3.Error at the first damage."""
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as base:
        # else a file that is shorter than its header states is refused as a whole
        base.execute("PRAGMA writable_schema=ON")
        yield from base.execute(text)


def _tables(path: Path) -> dict[int, tuple[str, str]]:
    """Topic and type by id, of as many as can be read."""
    found = {}
    with suppress(sqlite3.Error):
        for number, name, kind in _query(path, "SELECT id, name, type FROM topics"):
            found[number] = name, kind
    return found


def _salvage(path: Path, topics: Collection[str]) -> Iterator[tuple[str, str, int, bytes]]:
    known = {number: row for number, row in _tables(path).items() if row[0] in topics}
    for number, time, data in _query(path, "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"):
        if number in known:
            yield *known[number], time, data


def _goes_back(path: Path) -> bool:
    """Whether the recorder's clock was set back: a topic's times of recording lie before earlier ones."""
    steps = "SELECT timestamp - LAG(timestamp) OVER (PARTITION BY topic_id ORDER BY id) FROM messages"
    with suppress(sqlite3.Error):
        return any(step is not None and step < -RECORDER_LAG_NS for (step,) in _query(path, steps))
    return False


def _check_metadata(path: Path) -> None:
    """Raises LogError for a file that no recorder writes, for which a reader of YAML takes minutes."""
    if not path.is_file():
        return
    too_long = path.stat().st_size > MOST_METADATA_BYTES
    if too_long or nesting(path.read_text(encoding="utf-8", errors="replace")) > MOST_NESTED:
        raise LogError(f"{path}: is no bag's metadata: delete it, the bag is read without it")


class McapBag:
    """Messages of ROS or Foxglove in MCAP files, such as those that rosbag2 writes."""

    format = "MCAP"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counters: Counter[str] = Counter()

    @cached_property
    def _files(self) -> list[McapFile]:
        copies = Copies()
        files = reversed(_parts(self.path, "*.mcap", "*.mcap.zstd"))  # whose first is read next
        return [McapFile(file, self.counters, copies) for file in files][::-1]

    @property
    def progress(self) -> float:
        """Mean of the files."""
        return sum(file.progress for file in self._files) / len(self._files)

    def topics(self) -> dict[str, str]:
        """Types by topic."""
        channels = [channel for file in self._files for channel in file.channels()]
        return {topic: _named(encoding, schema) for topic, encoding, schema in channels}

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages by time of recording; in the order of the file if it was set back."""
        for file in self._files:
            for schema, channel, message in file.messages(list(topics)):
                found = _understood(channel.message_encoding, schema.name if schema else "")
                if found is not None:
                    time, data = message.log_time, message.data
                    yield from decoded(self.counters, channel.topic, time, data, found[1])


def _named(encoding: str, schema: str) -> str:
    """Type of message, and how it is encoded if it is not as ROS does."""
    if found := _understood(encoding, schema):
        return found[0]
    return kind_of(schema) if encoding in ("cdr", "ros1") else f"{schema} as {encoding}"


def _understood(encoding: str, schema: str) -> tuple[str, Decoder] | None:
    """Type of message and its decoder; None for types that are not read."""
    if encoding == "protobuf":
        return FOXGLOVE.get(schema)
    kind = kind_of(schema)
    if encoding in ("cdr", "ros1") and kind in KINDS:
        return kind, decoder(kind, encoding == "ros1")
    return None
