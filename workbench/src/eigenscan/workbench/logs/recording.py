"""The pipeline's own MCAP."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from eigenscan.runtime.recording import (
    Record,
    RecordingError,
    contents,
    is_complete,
    parts,
    read,
    read_metadata,
)
from eigenscan.schemas.channels import DEFAULT_ROBOT, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs.log import RECORDER_LAG_NS, LogError, LogOptions, in_order, place


class RecordingLog:
    """Raw scans and odometry of one robot in a recording, a file or a recorder's folder of files.

    Under the site and robot of the options.
    """

    format = "Eigenscan recording"

    def __init__(self, path: Path, options: LogOptions) -> None:
        self.path, self._options = path, options
        self.counters: Counter[str] = Counter()
        self.progress = 0.0
        self.logged: dict[int, int] = {}
        self.damage = ""
        self._imported = False
        self._size = max(sum(part.stat().st_size for part in parts(path)), 1)

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError if there is no scan, or several robots."""
        self.counters.clear()
        self.logged.clear()
        self.damage = ""
        robot = self._robot()
        self._imported = self._is_import()
        yield from in_order(self._of(robot), RECORDER_LAG_NS, self.counters, self.logged)
        if not self.counters["damaged_file"] and not self._is_complete():  # it was cut, or its writer killed
            self.counters["truncated_file"] += 1
        self.progress = 1.0

    def _robot(self) -> str:
        """The robot to take. Raises LogError where it, or a lidar that is asked for, is missing."""
        lidars: dict[str, set[str]] = {}
        sites: dict[str, set[str]] = {}
        for record in self._records():
            if record.envelope.channel == SCAN_RAW:
                address = record.envelope.address
                lidars.setdefault(address["robot"], set()).add(address["lidar"])
                sites.setdefault(address["robot"], set()).add(address["site"])
        if not lidars and self.damage:
            raise LogError(self.damage)
        if not lidars:
            raise LogError(f"{self.path}: holds no raw scan: record the channel {SCAN_RAW.template}")
        robot = self._options.robot
        if robot not in lidars:
            if len(lidars) > 1 or robot != DEFAULT_ROBOT:
                names = ", ".join(sorted(lidars))
                raise LogError(f"{self.path}: holds scans of {names}: choose one as robot")
            robot = next(iter(lidars))
        if len(sites[robot]) > 1:
            names = ", ".join(sorted(sites[robot]))
            raise LogError(
                f"{self.path}: holds a {robot} of each of the sites {names}: give the files of one"
            )
        missing = sorted(set(self._options.lidars) - lidars[robot])
        if missing:
            known = ", ".join(sorted(lidars[robot]))
            raise LogError(f"{self.path}: no lidar {missing[0]}: choose one of {known}")
        return robot

    def _is_complete(self) -> bool:
        """False also for an index that is damaged."""
        with suppress(RecordingError):
            return is_complete(self.path)
        return False

    def _is_import(self) -> bool:
        """Whether `eigenscan import` wrote it: then the times of publication are the stamps as logged."""
        with suppress(RecordingError):
            return "import" in read_metadata(self.path)
        return False

    def _of(self, robot: str) -> Iterator[Envelope]:
        own = {"site": self._options.site, "robot": self._options.robot}
        seen = 0
        for record in self._records():
            seen += record.size
            self.progress = min(seen / self._size, 1.0)
            envelope = record.envelope
            if envelope.channel not in (SCAN_RAW, ODOMETRY) or envelope.address["robot"] != robot:
                continue
            if self._imported and record.publish_time != record.log_time and envelope.channel == SCAN_RAW:
                self.logged[record.log_time] = record.publish_time
            lidar = envelope.address.get("lidar")
            if lidar is not None:
                place(self._options, lidar, envelope.open(RawScan))
            if lidar is None or not self._options.lidars or lidar in self._options.lidars:
                yield Envelope(envelope.channel, {**envelope.address, **own}, envelope.message)

    def _records(self) -> Iterator[Record]:
        """Records up to the first damage, which is described."""
        count = 0
        try:
            for record in read(self.path):
                count += 1
                yield record
        except RecordingError as error:
            self.counters["damaged_file"] = 1
            self.damage = f"{error}{self._share(count)}"

    def _share(self, count: int) -> str:
        """How much of the recording so many messages are, as text; empty where that is unknown."""
        with suppress(RecordingError):
            whole = max(contents(self.path).counts.total(), 1)
            return f"; only the first {min(count / whole, 1.0):.0%} of its messages were read"
        return ""
