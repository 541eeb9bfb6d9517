"""Reads CSV tables of ranges: a line for each scan (Hokuyo's tools) or for each beam (SLAMTEC's).

The header names the columns with their units; docs/data.md lists them.
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.schemas.channels import is_chunk
from eigenscan.schemas.envelope import LATEST_S, Envelope
from eigenscan.workbench.logs.log import (
    RECORDER_LAG_NS,
    LogError,
    LogOptions,
    in_order,
    odometry,
    raw_scan,
    single,
)
from numpy.typing import NDArray

TIME, LIDAR = "time_s", "lidar"
LINE_A_SCAN = ("angle_min_deg", "angle_increment_deg")
ODOMETRY = (
    {"x_m": 1.0, "x_cm": 1e-2, "x_mm": 1e-3},
    {"y_m": 1.0, "y_cm": 1e-2, "y_mm": 1e-3},
    {
        f"{name}_{unit}": factor
        for name in ("heading", "theta", "yaw")
        for unit, factor in (("deg", np.pi / 180.0), ("rad", 1.0))
    },
)
"""Columns of x, of y and of the heading, and their units in m and rad."""
LIMITS = ("range_min_m", "range_max_m")
INCREMENT = "time_increment_s"
ANGLES = {"angle_deg": 1.0, "angle_cw_deg": -1.0}
"""Columns with a beam's angle, and their sign: SLAMTEC's lidars count clockwise."""
RANGES = {"range_m": 1.0, "range_mm": 1e-3}
"""Columns with a beam's range (or, with _0, _1, ..., all ranges of a line), and their unit in m."""
KNOWN = frozenset({TIME, LIDAR, *LINE_A_SCAN, *LIMITS, INCREMENT, *ANGLES, *RANGES}.union(*ODOMETRY))
LONGEST_HEADER = 1_000_000
DEFAULT_LIDAR = "lidar"


def looks_like_csv(path: Path) -> bool:
    """Whether the first line names a column of times.

    Raises LogError for a table that a spreadsheet wrote with other separators or in another encoding.
    """
    with path.open("rb") as file:
        header = file.readline(LONGEST_HEADER)
    if TIME.encode("utf-16-le") in header or TIME.encode("utf-16-be") in header:
        raise LogError(f"{path}: is UTF-16: save it as UTF-8")
    for separator, what in ((",", ""), (";", "semicolons"), ("\t", "tabs")):
        rows = csv.reader([header.decode("utf-8-sig", "replace").strip()], delimiter=separator)
        try:
            names = next(rows, [])
        except csv.Error:  # of a file that is no table
            return False
        if TIME in map(str.lower, map(str.strip, names)):
            if what:
                raise LogError(f"{path}: line 1: columns are separated by {what}: separate them by commas")
            return True
    return False


@dataclass(frozen=True)
class _Columns:
    """The columns of a file."""

    path: Path
    places: Mapping[str, int]
    ranges: NDArray[np.int64]  # columns of the ranges, in the order of their beams
    unit: float  # of the ranges, m
    odometry: Mapping[str, float]  # columns of x, y and heading, and their units in m and rad; or none
    angle: str = ""  # column of a beam's angle, if each line is a beam

    @classmethod
    def read(cls, path: Path, names: list[str]) -> _Columns:
        """Raises LogError naming the column that is missing."""
        places = {name.strip(): place for place, name in enumerate(names)}
        if len(places) < len(names):
            raise LogError(f"{path}: line 1: two columns have the same name: give each its own")
        for name in places:
            if name != name.lower() in KNOWN:
                raise LogError(f"{path}: line 1: has the column {name}: rename it to {name.lower()}")
        angle = next((each for each in ANGLES if each in places), "")
        for name, unit in RANGES.items():
            beams = list[int]()
            while f"{name}_{len(beams)}" in places:
                beams.append(places[f"{name}_{len(beams)}"])
            if beams:
                _refuse_gaps(path, places, name, len(beams))
                missing = [each for each in LINE_A_SCAN if each not in places]
                if missing:
                    raise LogError(f"{path}: line 1: a line a scan needs the column {missing[0]}")
                return cls(path, places, np.array(beams), unit, _odometry(path, places, is_beam=False))
            if name in places and angle:
                of_odometry = _odometry(path, places, is_beam=True)
                return cls(path, places, np.array([places[name]]), unit, of_odometry, angle)
        raise LogError(
            f"{path}: line 1: no columns of ranges: give range_m_0, range_m_1, … (a line a scan), "
            "or angle_deg and range_m (a line a beam); in mm they are range_mm"
        )


def _refuse_gaps(path: Path, places: Mapping[str, int], name: str, count: int) -> None:
    """Raises LogError where a column of ranges is there and an earlier one is not."""
    stem = f"{name}_"
    numbers = [each[len(stem) :] for each in places if each.startswith(stem)]
    if later := [number for number in numbers if number.isdecimal() and int(number) > count]:
        raise LogError(f"{path}: line 1: has the column {stem}{later[0]} and lacks {stem}{count}")


def _odometry(path: Path, places: Mapping[str, int], *, is_beam: bool) -> dict[str, float]:
    """Columns of x, y and heading, and their units in m and rad; empty: there is no odometry.

    Raises LogError where one of them is missing or there twice. A beam's x and y without a heading are the
    point that it met.
    """
    found = [[name for name in named if name in places] for named in ODOMETRY]
    if not any(found) or (is_beam and not found[2]):
        return {}
    needs = "odometry needs x_m, y_m and heading_deg, or other units (_cm, _mm, _rad)"
    for named, there in zip(ODOMETRY, found, strict=True):
        if len(there) != 1:
            wrong = f"has {' and '.join(there)}: keep one" if there else f"lacks {next(iter(named))}: add it"
            raise LogError(f"{path}: line 1: {needs}; {wrong}; or, if it is no odometry, rename it")
    return {there[0]: named[there[0]] for named, there in zip(ODOMETRY, found, strict=True)}


@dataclass(frozen=True)
class _Line:
    """One line of the table."""

    columns: _Columns
    number: int
    cells: list[str]

    def text(self, name: str, default: str = "") -> str:
        """Text in a column, or `default`."""
        place = self.columns.places.get(name)
        return default if place is None else self.cells[place].strip() or default

    def value(self, name: str, default: float | None = None) -> float:
        """Number in a column. Raises LogError if there is none, and no default."""
        text = self.text(name)
        if not text and default is not None:
            return default
        try:
            number = float(text)
        except ValueError:
            raise self._bad(name, text) from None
        if not np.isfinite(number):
            raise self._bad(name, text)
        return number

    @property
    def has_beams(self) -> bool:
        """Whether there is more than odometry."""
        columns = self.columns
        angle = columns.angle or LINE_A_SCAN[0]
        return bool(self.text(angle)) or any(self.cells[place].strip() for place in columns.ranges)

    def ranges(self) -> NDArray[np.float64]:
        """Ranges, m; NaN for empty cells."""
        cells = [self.cells[place].strip() or "nan" for place in self.columns.ranges]
        try:
            return np.array(cells, dtype=np.float64) * self.columns.unit
        except ValueError:
            names = list(self.columns.places)
            for place, text in zip(self.columns.ranges, cells, strict=True):
                try:
                    float(text)
                except ValueError:
                    raise self._bad(names[place], text) from None
            raise

    def _bad(self, name: str, text: str) -> LogError:
        what = f"{text!r} is no number that can be used" if text else "is empty"
        return LogError(f"{self.columns.path}: line {self.number}, column {name}: {what}")


@dataclass
class CsvLog:
    """A CSV of scans; see the module."""

    path: Path
    options: LogOptions
    format: str = "CSV"
    progress: float = 0.0
    counters: Counter[str] = field(default_factory=Counter)
    logged: dict[int, int] = field(default_factory=dict)
    damage: str = ""

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError that names line and column."""
        self.counters.clear()
        self.logged.clear()
        yield from in_order(self._convert(), RECORDER_LAG_NS, self.counters, self.logged)
        self.progress = 1.0

    def _convert(self) -> Iterator[Envelope]:
        taken, alone, flat, seen = 0, 0, 0, set[str]()
        grids: dict[str, tuple[float, float]] = {}
        for time, lidar, group in self._groups():
            lines = group
            if not 0 <= time <= LATEST_S:
                raise LogError(f"{self.path}: line {lines[0].number}, column {TIME}: {time:g} s is no time")
            stamp = round(time * 1e9)
            of_odometry = lines[0].columns.odometry
            moved = next((line for line in lines if any(map(line.text, of_odometry))), None)
            if moved is not None:
                pose = [moved.value(name) * unit for name, unit in of_odometry.items()]
                yield odometry(self.options, stamp, pose)
                lines = [line for line in lines if line.has_beams]
                if not lines:
                    continue
            is_new = lidar not in seen
            seen.add(lidar)
            if self.options.lidars and lidar not in self.options.lidars:
                self.counters["scans_of_another_lidar"] += 1
                continue
            if is_new and lidar not in self.options.mounts:
                self.counters["lidars_without_mount"] += 1
            if not lines[0].columns.angle:
                for line in lines:
                    yield self._scan(line, stamp, lidar, *_row(line))
                flat += line.value(LINE_A_SCAN[1]) == 0
            else:
                angles, ranges = _beams(lines)
                own = max(_step(angles), FINEST_DEG)
                # a scan of few beams shows too coarse a grid
                if lidar not in grids or own < FINER * grids[lidar][1]:
                    grids[lidar] = _phase(angles, own), own
                yield self._scan(lines[0], stamp, lidar, *_on_grid(angles, ranges, *grids[lidar]))
            taken += 1
            alone += len(lines) == 1 and bool(lines[0].columns.angle)
        self._check(taken, alone, flat, seen)

    def _check(self, taken: int, alone: int, flat: int, seen: set[str]) -> None:
        """Raises LogError where none of the scans can be used: `alone` of one beam, `flat` of no step."""
        if alone == taken > MOST_ALONE:
            raise LogError(
                f"{self.path}: each beam has a {TIME} of its own: give all of a turn that of its first"
            )
        if flat and flat == taken:
            raise LogError(f"{self.path}: column {LINE_A_SCAN[1]}: is 0 in all lines: give the beams' step")
        if not taken:
            there = f"there are {', '.join(sorted(seen))}" if seen else "the header alone"
            raise LogError(f"{self.path}: no scan to take: {there}")

    def _scan(
        self, line: _Line, stamp: int, lidar: str, first: float, step: float, ranges: NDArray[np.float64]
    ) -> Envelope:
        low, high = (line.value(name, 0.0) for name in LIMITS)
        return raw_scan(
            self.options,
            lidar,
            stamp,
            np.zeros(3),
            frame_id=lidar,
            angle_min=float(first),
            angle_increment=float(step),
            range_min=low,
            range_max=high,
            ranges=single(ranges),
            # beams of lines of their own were sorted by angle
            time_increment=0.0 if line.columns.angle else line.value(INCREMENT, 0.0),
        )

    def _groups(self) -> Iterator[tuple[float, str, list[_Line]]]:
        """Lines that follow each other with one time, s, those of each lidar together."""
        for time, group in groupby(self._lines(), lambda line: line.value(TIME)):
            lidars: dict[str, list[_Line]] = {}
            for line in group:
                lidars.setdefault(_lidar(line), []).append(line)
            for lidar, lines in lidars.items():
                yield time, lidar, lines

    def _lines(self) -> Iterator[_Line]:
        size = max(self.path.stat().st_size, 1)
        with self.path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            rows = csv.reader(file)
            columns = _Columns.read(self.path, next(self._rows(rows)))
            read = 0  # csv reads ahead, so the file's position is not the line's
            for cells in self._rows(rows):
                read += sum(map(len, cells)) + len(cells)
                self.progress = min(read / size, 1.0)
                if not cells:
                    continue
                if len(cells) != len(columns.places):
                    counts = f"{len(cells)} columns, the header has {len(columns.places)}"
                    raise LogError(f"{self.path}: line {rows.line_num}: {counts}")
                yield _Line(columns, rows.line_num, cells)

    def _rows(self, rows: Any) -> Iterator[list[str]]:
        try:
            yield from rows
        except csv.Error as error:
            raise LogError(f"{self.path}: line {rows.line_num}: {error}") from error


def _lidar(line: _Line) -> str:
    """Raises LogError for a name that no lidar can have."""
    name = line.text(LIDAR, DEFAULT_LIDAR)
    if not is_chunk(name):
        fix = "rename it, without blanks or / * $ # ? @"
        raise LogError(f"{line.columns.path}: line {line.number}, column {LIDAR}: {name!r:.80}: {fix}")
    return name


def _row(line: _Line) -> tuple[float, float, NDArray[np.float64]]:
    """First angle and step, rad, and ranges of a line that is a scan."""
    first, step = (np.deg2rad(line.value(name)) for name in LINE_A_SCAN)
    return float(first), float(step), line.ranges()


def _beams(lines: list[_Line]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles in [0, 360) deg, counter-clockwise, and ranges, m, NaN of quality 0, of lines that are beams."""
    turn = ANGLES[lines[0].columns.angle]
    angles = np.array([line.value(line.columns.angle) for line in lines]) * turn % 360.0
    ranges = np.concatenate([line.ranges() for line in lines])
    quality = np.array([line.value("quality", 1.0) for line in lines])
    return angles, np.where(quality > 0, ranges, np.nan)


FINEST_DEG = 0.01
"""Between beams, at least: finer than any lidar. A slip in an angle would ask for beams without end."""
MOST_ALONE = 10
"""Scans of one beam each, and no others, that a log may hold."""
FINER = 0.75
"""Share of a lidar's grid from which on that of another of its scans takes its place."""
GAP = 3.0
"""Beams so many middle distances apart have a gap between them."""


def _step(angles: NDArray[np.float64]) -> float:
    """Step, deg, of the even grid that fits uneven beams, a whole part of a turn."""
    places = np.unique(angles)
    apart = np.diff(places, append=places[0] + 360.0)
    beside = apart[apart < GAP * np.median(apart)]
    return 360.0 / max(2, round(360.0 / float(np.mean(beside))))


def _phase(angles: NDArray[np.float64], step: float) -> float:
    """Angle, deg, of the grid's beam beside 0: where most beams have one of theirs."""
    around = np.exp(1j * np.deg2rad(angles * (360.0 / step))).sum()
    return float(np.rad2deg(np.angle(around))) * step / 360.0


def _on_grid(
    angles: NDArray[np.float64], ranges: NDArray[np.float64], phase: float, step: float
) -> tuple[float, float, NDArray[np.float64]]:
    """A full turn of beams, rad; each has the range with the nearest angle, or none if none is near."""
    count = round(360.0 / step)
    exact = (angles - phase) / step
    place = np.round(exact)
    far_first = np.argsort(-np.abs(exact - place), kind="stable")
    grid = np.full(count, np.nan)
    grid[place[far_first].astype(np.int64) % count] = ranges[far_first]
    half = count // 2
    return float(np.deg2rad(phase - half * step)), float(np.deg2rad(step)), np.roll(grid, half)
