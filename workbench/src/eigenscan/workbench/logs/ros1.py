"""ROS 1 bags (format 2.0), read front to back, so that cut and unindexed bags can be read.

http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import bz2
import io
import struct
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO

from eigenscan.workbench.logs.bag import KINDS, BagMessage, decoded, decoder, kind_of
from eigenscan.workbench.logs.log import LogError

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG_HEADER, CHUNK, CONNECTION = 2, 3, 5, 7
LONGEST_RECORD = 1 << 30

Header = dict[bytes, bytes]


class CutOffError(Exception):
    """The bag ends, or turns to garbage, within a record."""


DAMAGE = (CutOffError, OSError, EOFError, LookupError, ValueError, struct.error)


class Ros1Bag:
    """A ROS 1 bag."""

    format = "ROS 1 bag"

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counters: Counter[str] = Counter()
        self.progress = 0.0
        self._size = max(path.stat().st_size, 1)
        self._connections: dict[int, tuple[str, str]] = {}

    def topics(self) -> dict[str, str]:
        """Types by topic, from the index or, without one, from the whole file."""
        with self.path.open("rb") as file:
            try:
                indexed = self._read_index(file)
            except DAMAGE:
                indexed = False
        if not indexed:
            for _ in self._records(Counter()):
                pass
        return dict(self._connections.values())

    def messages(self, topics: Collection[str]) -> Iterator[BagMessage]:
        """Messages in the order of the file."""
        wanted = {
            number: (topic, decoder(kind, ros1=True))
            for number, (topic, kind) in self._connections.items()
            if topic in topics and kind in KINDS
        }
        for header, data in self._records(self.counters):
            if header[b"op"][0] != MESSAGE:
                continue
            if len(header.get(b"time", b"")) != 8 or b"conn" not in header:
                self.counters["undecodable_message"] += 1
                continue
            found = wanted.get(_number(header, b"conn"))
            if found is not None:
                seconds, nanoseconds = struct.unpack("<II", header[b"time"])
                time = seconds * 1_000_000_000 + nanoseconds
                yield from decoded(self.counters, found[0], time, data, found[1])

    def _read_index(self, file: IO[bytes]) -> bool:
        """Reads the connections at the end of the bag; False if they are missing."""
        if file.read(len(MAGIC)) != MAGIC:
            raise LogError(f"{self.path}: is no ROS 1 bag of format 2.0: convert it with `rosbag fix`")
        header, _ = _record(file)
        place = int.from_bytes(header.get(b"index_pos", b""), "little")
        if header[b"op"][0] != BAG_HEADER or not len(MAGIC) < place < self._size:
            return False
        file.seek(place)
        for _ in range(_number(header, b"conn_count")):
            self._note(*_record(file))
        return bool(self._connections)

    def _note(self, header: Header, data: bytes) -> None:
        if header[b"op"][0] == CONNECTION:
            details = _fields(data)
            kind = kind_of(details.get(b"type", b"").decode("latin-1"))
            self._connections[_number(header, b"conn")] = (header[b"topic"].decode("latin-1"), kind)

    def _records(self, counters: Counter[str]) -> Iterator[tuple[Header, bytes]]:
        """All records, within chunks or not; connections are noted on the way."""
        with self.path.open("rb") as file:
            file.seek(len(MAGIC))
            try:
                while file.tell() < self._size:
                    self.progress = file.tell() / self._size
                    header, data = _record(file)
                    if header[b"op"][0] == CHUNK:
                        yield from self._chunk(header, data, counters, last=file.tell() >= self._size)
                    else:
                        self._note(header, data)
                        yield header, data
            except DAMAGE:
                counters["truncated_file"] += 1

    def _chunk(
        self, header: Header, data: bytes, counters: Counter[str], last: bool
    ) -> Iterator[tuple[Header, bytes]]:
        try:
            for inner in _chunk(header, data):
                self._note(*inner)
                yield inner
        except DAMAGE:
            counters["truncated_file" if last else "damaged_chunk"] += 1


def _chunk(header: Header, data: bytes) -> Iterator[tuple[Header, bytes]]:
    """Records of a chunk, of which only the beginning may be there."""
    compression = header[b"compression"]
    if compression == b"bz2":
        data = bz2.BZ2Decompressor().decompress(data)
    elif compression == b"lz4":
        from lz4.frame import LZ4FrameDecompressor

        try:
            data = LZ4FrameDecompressor().decompress(data)
        except RuntimeError as error:
            raise CutOffError from error
    file = io.BytesIO(data)
    while file.tell() < len(data):
        yield _record(file)
    if len(data) < _number(header, b"size"):
        raise CutOffError


def _record(file: IO[bytes]) -> tuple[Header, bytes]:
    """Next record. Raises CutOffError, but for a chunk, which is given as far as it goes."""
    header = _fields(_sized(file))
    if len(header.get(b"op", b"")) != 1:
        raise CutOffError
    return header, _sized(file, whole=header[b"op"][0] != CHUNK)


def _sized(file: IO[bytes], whole: bool = True) -> bytes:
    prefix = file.read(4)
    size = int.from_bytes(prefix, "little")
    if len(prefix) < 4 or size > LONGEST_RECORD:
        raise CutOffError
    data = file.read(size)
    if whole and len(data) < size:
        raise CutOffError
    return data


def _fields(data: bytes) -> Header:
    fields: Header = {}
    place = 0
    while place + 4 <= len(data):
        size = int.from_bytes(data[place : place + 4], "little")
        name, _, value = data[place + 4 : place + 4 + size].partition(b"=")
        fields[name] = value
        place += 4 + size
    return fields


def _number(header: Header, name: bytes) -> int:
    return int.from_bytes(header[name], "little")
