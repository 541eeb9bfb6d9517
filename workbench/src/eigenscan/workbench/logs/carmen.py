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
from contextlib import suppress
from dataclasses import dataclass, field
from io import BufferedReader
from itertools import compress, islice
from pathlib import Path

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.logs.carmen_lines import (
    LIDAR_OF,
    Geometry,
    Line,
    LineError,
    read_line,
)
from eigenscan.workbench.logs.log import LogError, LogOptions, in_order, odometry, raw_scan, single
from eigenscan.workbench.logs.stamps import repair_stamps
from numpy.typing import NDArray

KNOWN_KINDS = frozenset({*LIDAR_OF, "ODOM", "PARAM", "SYNC", "TRUEPOS"})
LINES_LOOKED_AT = 200
LONGEST_LINE = 4_000_000
PIECE = 2**16
"""Bytes that are read at a time."""

SAMPLES = 2000
SATURATED_SHARE, SAME_WALL_SHARE, ENOUGH_BESIDE = 0.002, 0.5, 100
MARKER_SPREAD = 0.01
"""Relative spread of the markers for no return: a SICK has some from 51.05 to 51.16 m."""

SAME_MOUNT_M, SAME_MOUNT_RAD = 0.02, 0.02


@dataclass
class _Samples:
    """Ranges of SAMPLES scans at most, evenly over the log; of a short log all."""

    scans: list[NDArray[np.float64]] = field(default_factory=list)
    every: int = 1
    received: int = 0

    def note(self, line: Line) -> None:
        """Takes a scan's ranges, if it is its turn."""
        if self.received % self.every == 0:
            with suppress(LineError):
                self.scans.append(line.ranges())
        self.received += 1
        if len(self.scans) > SAMPLES:
            self.scans = self.scans[::2]
            self.every *= 2

    @property
    def ranges(self) -> NDArray[np.float64]:
        """One scan's after the other's, m."""
        return np.concatenate([np.empty(0), *self.scans])


@dataclass
class _Survey:
    """Results of the first reading of the log."""

    taken: bytearray = field(default_factory=bytearray)
    """Of each line of the file: whether it is one with a stamp."""
    kinds: list[str] = field(default_factory=list)
    stamps: list[int] = field(default_factory=list)
    mounts: dict[str, list[NDArray[np.float64]]] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    samples: dict[str, _Samples] = field(default_factory=dict)

    def note(self, line: Line) -> None:
        """Takes note of a line with a stamp."""
        self.kinds.append(line.kind)
        self.stamps.append(line.stamp)
        mount = line.mount()
        if mount is not None and np.isfinite(mount).all():
            self.mounts.setdefault(line.kind, []).append(mount)
        if line.geometry is not None:
            self.samples.setdefault(line.kind, _Samples()).note(line)

    def range_max(self, kind: str, stated: float) -> float:
        """Limit of a kind's ranges, m: the least of those in the line, the parameters and the ranges."""
        named = self.parameters.get("robot_front_laser_max", 0.0) if LIDAR_OF[kind] == "front" else 0.0
        limits = (
            stated,
            named,
            saturation(self.samples[kind].ranges if kind in self.samples else np.empty(0)),
        )
        return min((limit for limit in limits if limit > 0.0), default=0.0)

    def mount(self, kind: str) -> NDArray[np.float64]:
        """Median of the mounts if they agree; otherwise (a corrected log) the parameters' mount."""
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
        self.damage = ""
        self._size = max(path.stat().st_size, 1)

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError if there is no scan line."""
        self.counters.clear()
        survey = self._survey()
        taken = self._kinds(survey)
        if not taken:
            there = sorted({LIDAR_OF[kind] for kind in survey.kinds if kind in LIDAR_OF})
            what = "no scan line could be read: expected FLASER, ROBOTLASER1 or RAWLASER1 lines"
            if there:
                what = f"no lidar {self._options.lidars[0]}: choose one of {', '.join(there)}"
            raise LogError(f"{self.path}: {what}")
        logged = np.array(survey.stamps, dtype=np.int64)
        times = repair_stamps(logged, survey.kinds)
        self.counters["stamps_repaired"] += int(np.count_nonzero(times != logged))
        scans = np.isin(survey.kinds, list(taken)) & (times != logged)
        self.logged = dict(zip(times[scans].tolist(), logged[scans].tolist(), strict=True))
        horizon = int(np.max(np.maximum.accumulate(times) - times))
        yield from in_order(self._convert(survey, taken, times), horizon, self.counters, self.logged)
        self.progress = 1.0

    def _convert(
        self, survey: _Survey, taken: dict[str, str], times: NDArray[np.int64]
    ) -> Iterator[Envelope]:
        mounts = {kind: survey.mount(kind) for kind in taken}
        limits: dict[tuple[str, float], float] = {}
        texts = compress(self._texts(Counter(), False), survey.taken)
        for number, line in enumerate(filter(None, map(read_line, texts))):
            self.progress = 0.5 + 0.5 * number / len(times)
            time = int(times[number])
            if line.odometry is not None:
                if np.isfinite(line.odometry).all():
                    yield odometry(self._options, time, line.odometry)
                else:
                    self.counters["odometry_not_finite"] += 1
            if line.geometry is None:
                continue
            if line.kind not in taken:
                self.counters["scans_of_another_lidar_or_kind"] += 1
                continue
            limit = (line.kind, line.geometry.range_max)
            if limit not in limits:
                limits[limit] = survey.range_max(*limit)
            yield from self._scan(
                line, line.geometry, taken[line.kind], time, mounts[line.kind], limits[limit]
            )

    def _scan(
        self,
        line: Line,
        geometry: Geometry,
        lidar: str,
        time: int,
        mount: NDArray[np.float64],
        range_max: float,
    ) -> Iterator[Envelope]:
        try:
            ranges = line.ranges()
        except LineError as error:
            self.counters[error.reason] += 1
            return
        yield raw_scan(
            self._options,
            lidar,
            time,
            mount,
            frame_id=lidar,
            angle_min=geometry.angle_min,
            angle_increment=geometry.angle_increment,
            range_max=range_max,
            ranges=single(ranges),
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
        for text in self._texts(self.counters, True):
            line = None
            try:
                line = read_line(text)
            except LineError as error:
                self.counters[error.reason] += 1
            survey.taken.append(line is not None)
            if line is not None:
                survey.note(line)
            elif text.startswith("PARAM "):
                _note_parameter(text, survey.parameters)
        return survey

    def _texts(self, counters: Counter[str], first: bool) -> Iterator[str]:
        try:
            for place, text in _texts(self.path):
                if first:
                    self.progress = 0.5 * min(place / self._size, 1.0)
                yield text
        except (EOFError, OSError, zlib.error):
            counters["truncated_file"] += 1


def saturation(ranges: NDArray[np.float64]) -> float:
    """Least range, m, by which a laser means no return: the greatest ranges if they stand out; else 0.

    `ranges`: those of many scans, one after the other. They stand out if they are frequent and neighbouring
    beams are far shorter, unlike beside the far end of a hall.
    """
    with np.errstate(invalid="ignore"):
        top = float(np.max(ranges, where=np.isfinite(ranges), initial=0.0))
        marked = np.isfinite(ranges) & (ranges >= (1.0 - MARKER_SPREAD) * top)
        beside = ranges[(np.roll(marked, 1) | np.roll(marked, -1)) & ~marked]
        frequent = len(beside) >= ENOUGH_BESIDE and marked.mean() > SATURATED_SHARE
        found = frequent and np.mean(beside > 0.9 * top) < SAME_WALL_SHARE
        # its lower edge, but for the few true ranges in that band
        return float(np.quantile(ranges[marked], 0.05, method="lower")) if found else 0.0


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
        file: BufferedReader | gzip.GzipFile | bz2.BZ2File = raw
        if magic == b"\x1f\x8b":
            file = gzip.GzipFile(fileobj=raw)
        elif magic == b"BZ":
            file = bz2.BZ2File(raw)
        rest = ""
        while piece := file.read1(PIECE):  # what comes before damage is read; their readline is slow
            *lines, rest = (rest + piece.decode("latin-1")).split("\n")
            place = raw.tell()
            for line in lines:
                yield place, line
            if len(rest) > LONGEST_LINE:
                yield place, rest
                rest = ""
        if rest:
            yield raw.tell(), rest


def _note_parameter(text: str, parameters: dict[str, float]) -> None:
    words = text.split()
    if len(words) >= 3 and "laser" in words[1]:
        try:
            parameters[words[1]] = float(words[2])
        except ValueError:
            return
