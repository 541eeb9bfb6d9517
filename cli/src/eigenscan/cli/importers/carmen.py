"""CARMEN logs: FLASER, RLASER, ROBOTLASERn, RAWLASERn and ODOM lines, plain, gzip or bzip2.

A scan line that carries poses gives a scan and odometry of the same stamp. The mount is the laser's
pose seen from the robot's.

Stamps that do not increase are repaired by the order of the lines: see `stamps`.
"""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import IO, cast

import numpy as np
from eigenscan.cli.importers.carmen_lines import (
    LIDAR_OF,
    SICK_NO_RETURN,
    Line,
    LineError,
    read_line,
)
from eigenscan.cli.importers.log import LogError, LogOptions, in_order, odometry, raw_scan
from eigenscan.cli.importers.stamps import repair_stamps
from eigenscan.geometry.circle import wrap
from eigenscan.schemas.envelope import Envelope
from numpy.typing import NDArray

KNOWN_KINDS = frozenset({*LIDAR_OF, "ODOM", "PARAM", "SYNC", "TRUEPOS"})
LINES_LOOKED_AT = 200
LONGEST_LINE = 4_000_000

SAME_MOUNT_M, SAME_MOUNT_RAD = 0.02, 0.02


@dataclass
class _Survey:
    """What a first reading of the log tells."""

    kinds: list[str] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    mounts: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)

    def mount(self, kind: str) -> NDArray[np.float64]:
        """Median of the mounts where they agree; else (a corrected log) what the parameters say."""
        place = "front" if LIDAR_OF[kind] == "front" else "rear"
        known = self.parameters.get
        stated = [known(f"robot_{place}laser_{name}", 0.0) for name in ("offset", "side_offset")]
        turn = known(f"robot_{place}laser_angular_offset", 0.0 if place == "front" else np.pi)
        given = self.mounts.get(kind)
        if not given:
            return np.array([*stated, turn])
        seen = np.array(given)
        seen[:, 2] = seen[0, 2] + wrap(seen[:, 2] - seen[0, 2])
        middle = np.median(seen, axis=0)
        off = np.abs(seen - middle)
        agree = (np.hypot(off[:, 0], off[:, 1]) < SAME_MOUNT_M) & (off[:, 2] < SAME_MOUNT_RAD)
        return middle if agree.mean() > 0.9 else np.array([*stated, turn])


class CarmenLog:
    """A CARMEN log; see the module for how stamps and mounts are found."""

    format = "CARMEN log"

    def __init__(self, path: Path, options: LogOptions) -> None:
        self.path, self._options = path, options
        self.counters: Counter[str] = Counter()
        self.progress = 0.0
        self.logged: dict[int, int] = {}
        self._size = max(path.stat().st_size, 1)

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError where there is no scan line."""
        self.counters.clear()
        survey = self._survey()
        taken = self._kinds(survey)
        if not taken:
            raise LogError(
                f"{self.path}: no scan line could be read: expected FLASER, ROBOTLASER1 or RAWLASER1 lines"
            )
        logged = np.array(survey.stamps, dtype=np.int64)
        times = repair_stamps(logged, survey.kinds)
        self.counters["stamps_repaired"] += int(np.count_nonzero(times != logged))
        scans = np.isin(survey.kinds, list(taken)) & (times != logged)
        self.logged = dict(zip(times[scans].tolist(), logged[scans].tolist(), strict=True))
        horizon = int(np.max(np.maximum.accumulate(times) - times))
        yield from in_order(self._convert(survey, taken, times), horizon, self.counters)
        self.progress = 1.0

    def _convert(
        self, survey: _Survey, taken: dict[str, str], times: NDArray[np.int64]
    ) -> Iterator[Envelope]:
        mounts = {kind: survey.mount(kind) for kind in taken}
        limit = survey.parameters.get("robot_front_laser_max", SICK_NO_RETURN)
        for number, line in enumerate(self._lines()):
            self.progress = 0.5 + 0.5 * number / len(times)
            time = int(times[number])
            if line.odometry is not None:
                if np.isfinite(line.odometry).all():
                    yield odometry(self._options, time, line.odometry)
                else:
                    self.counters["odometry_not_finite"] += 1
            if line.kind not in taken or line.geometry is None:
                self.counters["same_scan_again"] += line.geometry is not None
                continue
            try:
                ranges = line.ranges()
            except LineError as error:
                self.counters[error.reason] += 1
                continue
            geometry = line.geometry
            old = line.kind in ("FLASER", "RLASER")
            yield raw_scan(
                self._options,
                taken[line.kind],
                time,
                mounts[line.kind],
                frame_id=taken[line.kind],
                angle_min=geometry.angle_min,
                angle_increment=geometry.angle_increment,
                range_max=min(geometry.range_max, limit) if old else geometry.range_max,
                ranges=ranges.astype(np.float32).tolist(),
            )

    def _kinds(self, survey: _Survey) -> dict[str, str]:
        """Kinds of scan line to take, one for each lidar, with the lidar's name."""
        taken: dict[str, str] = {}
        present = set(survey.kinds)
        for kind, lidar in LIDAR_OF.items():
            wanted = not self._options.lidars or {kind, lidar} & set(self._options.lidars)
            if kind in present and wanted and lidar not in taken.values():
                taken[kind] = lidar
        return taken

    def _survey(self) -> _Survey:
        survey = _Survey()
        for line in self._lines(survey.parameters, self.counters):
            survey.kinds.append(line.kind)
            survey.stamps.append(line.stamp)
            mount = line.mount()
            if mount is not None and np.isfinite(mount).all():
                survey.mounts.setdefault(line.kind, []).append(mount)
        return survey

    def _lines(
        self, parameters: dict[str, float] | None = None, counters: Counter[str] | None = None
    ) -> Iterator[Line]:
        """Lines with a stamp; counts what cannot be read."""
        counted = Counter[str]() if counters is None else counters
        for text in self._texts(counted, counters is not None):
            try:
                line = read_line(text)
            except LineError as error:
                counted[error.reason] += 1
                continue
            if line is not None:
                yield line
            elif parameters is not None and text.startswith("PARAM "):
                _note_parameter(text, parameters)

    def _texts(self, counters: Counter[str], first: bool) -> Iterator[str]:
        try:
            for place, text in _texts(self.path):
                if first:
                    self.progress = 0.5 * min(place / self._size, 1.0)
                yield text
        except (EOFError, OSError, zlib.error):
            counters["truncated_file"] += 1


def looks_like_carmen(path: Path) -> bool:
    """Whether one of the first lines is of a kind that a CARMEN log has."""
    try:
        for _, text in islice(_texts(path), LINES_LOOKED_AT):
            if text.split(maxsplit=1)[:1] and text.split(maxsplit=1)[0] in KNOWN_KINDS:
                return True
    except (EOFError, OSError, zlib.error):
        return False
    return False


def _texts(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of a plain, gzip or bzip2 file, and how many bytes of the file were read so far."""
    with path.open("rb") as raw:
        magic = raw.read(2)
        raw.seek(0)
        file: IO[bytes] = raw
        if magic == b"\x1f\x8b":
            file = cast(IO[bytes], gzip.GzipFile(fileobj=raw))
        elif magic == b"BZ":
            file = bz2.BZ2File(raw)
        for line in iter(partial(file.readline, LONGEST_LINE), b""):
            yield raw.tell(), line.decode("latin-1")


def _note_parameter(text: str, parameters: dict[str, float]) -> None:
    words = text.split()
    if len(words) >= 3 and "laser" in words[1]:
        try:
            parameters[words[1]] = float(words[2])
        except ValueError:
            return
