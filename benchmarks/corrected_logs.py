"""Buildings for `evaluate.py --buildings`, from CARMEN logs that SLAM has corrected.

    .venv/bin/python benchmarks/corrected_logs.py LOGS OUT [--parts]
    .venv/bin/python benchmarks/evaluate.py --buildings OUT --kidnap

LOGS holds NAME.log.gz, as GMapping writes them and public collections (Radish) have them: FLASER lines
with corrected poses, and after each of them raw odometry that begins at that pose. Every other scan
makes the map, all are received, and those that made no map are tried alone. With `--parts` the scans of
every other 30 m make the map, so that the robot also drives where there is none. The references are the
corrected poses, as good as they are.
"""

import argparse
import gzip
from contextlib import suppress
from pathlib import Path

import numpy as np
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.geometry.pose import Array, between, compose, transform
from eigenscan.workbench.logs.carmen import saturation
from eigenscan.workbench.logs.carmen_lines import NS, Line, LineError, read_line

PART_M, WINDOW_M, EVERY_M = 30.0, 30.0, 10.0
SINGLE_SCANS = 100
SPEED = 0.5
"""m/s and rad/s, of the robot where the stamps give no time."""
USUAL_NOISE = 0.05
"""Of the way: error of odometry where the log has none between two scans."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", type=Path, help="folder of NAME.log.gz")
    parser.add_argument("out", type=Path, help="folder to write a folder for each log to")
    parser.add_argument("--parts", action="store_true", help="leave every other 30 m out of the map")
    options = parser.parse_args()
    for path in sorted(options.logs.glob("*.log.gz")):
        folder = options.out / path.name.removesuffix(".log.gz").removesuffix("-corrected")
        folder.mkdir(parents=True, exist_ok=True)
        write_building(read(path), folder, options.parts)
        print(folder)


def read(path: Path) -> list[Line]:
    """Scan and odometry lines in the order of the file."""
    lines = []
    with gzip.open(path, "rt", encoding="latin-1") as file:
        for text in file:
            with suppress(LineError):
                line = read_line(text)
                lines += [line] if line and line.kind in ("FLASER", "ODOM") else []
    return lines


def write_building(lines: list[Line], folder: Path, parts: bool) -> None:
    """Map, log, reference, windows and single scans of one log."""
    places = np.array([i for i, line in enumerate(lines) if line.kind == "FLASER"])
    scans = [lines[place] for place in places]
    poses = np.array([scan.odometry for scan in scans])
    steps = [
        odometry_step(lines[first + 1 : last], here, there, seed)
        for seed, (first, last, here, there) in enumerate(
            zip(places, places[1:], poses, poses[1:], strict=False)
        )
    ]
    times = stamps(np.array([scan.stamp for scan in scans]) / NS, steps)
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    mapped = way // PART_M % 2 == 0 if parts else np.arange(len(scans)) % 2 == 0
    ranges = [scan.ranges() for scan in scans]
    limit = 0.99 * saturation(np.concatenate(ranges)) or np.inf
    write_map(
        carve([(poses[i], scans[i], ranges[i]) for i in np.flatnonzero(mapped)], limit), folder / "map.yaml"
    )
    _write_log(folder / "log.clf", scans, steps, times, poses[0])
    rows = [
        f"{t:.6f} {x} {y} 0 0 0 {np.sin(a / 2)} {np.cos(a / 2)}"
        for t, (x, y, a) in zip(times, poses, strict=True)
    ]
    _write(folder / "log.tum", rows)
    begins = [
        np.flatnonzero((way >= a) & (way <= a + WINDOW_M)) for a in np.arange(0, way[-1] - EVERY_M, EVERY_M)
    ]
    windows = [f"{times[held[0]]:.6f},{times[held[-1]]:.6f}" for held in begins if len(held) > 5]
    _write(folder / "windows.csv", ["start_time,end_time", *windows])
    free = np.flatnonzero(~mapped)
    chosen = free[np.unique(np.linspace(0, len(free) - 1, SINGLE_SCANS).round().astype(int))]
    _write(folder / "single_scans.csv", ["time", *(f"{time:.6f}" for time in times[chosen])])


def odometry_step(between_scans: list[Line], here: Array, there: Array, seed: int) -> Array:
    """Way (n, 3) that odometry shows from one scan to the next, seen from the first one.

    It ends before the second scan: the last bit is the one before it once more, as long as fits best.
    """
    known = [line.odometry for line in between_scans if line.odometry is not None]
    reported = np.array([between(here, pose) for pose in known if not np.allclose(pose, here, atol=1e-5)])
    true = between(here, there)
    if len(reported) < 2:
        noise = USUAL_NOISE * np.random.default_rng(seed).normal(size=3) * np.abs(true).max()
        made_up: Array = np.linspace(0.2, 1.0, 5)[:, None] * (true + noise)
        return made_up
    last, missing = between(reported[-2], reported[-1]), between(reported[-1], true)
    share = min(max(float(last @ missing) / max(float(last @ last), 1e-9), 0.0), 2.0)
    return np.vstack([reported, compose(reported[-1], share * last)])


def stamps(logged: Array, steps: list[Array]) -> Array:
    """Seconds (n,) of the scans: as logged where they increase, else by the way at a usual speed."""
    if np.all(np.diff(logged) > 0):
        return logged
    moved = np.array([step[-1] for step in steps])
    spans = np.maximum.reduce([np.hypot(moved[:, 0], moved[:, 1]), np.abs(moved[:, 2])]) / SPEED
    found: Array = 100.0 + np.concatenate([[0.0], np.cumsum(np.maximum(spans, 0.1))])
    return found


def carve(seen: list[tuple[Array, Line, Array]], limit: float) -> GridMap:
    """Map of what scans (pose, line, ranges) saw nearer than `limit`, m."""
    starts, ends = [], []
    for pose, line, ranges in seen:
        assert line.geometry is not None
        hit = (ranges > 0.05) & (ranges < limit)
        angles = line.geometry.angle_min + line.geometry.angle_increment * np.flatnonzero(hit)
        ends.append(transform(pose, ranges[hit, None] * np.column_stack([np.cos(angles), np.sin(angles)])))
        starts.append(np.broadcast_to(pose[:2], ends[-1].shape))
    carving = Carving.around(np.concatenate([*starts, *ends]), 0.05)
    carving.add(np.concatenate(starts), np.concatenate(ends))
    return carving.to_map(least_hits=1)  # scans are a metre apart: far walls are hit once


def _write_log(path: Path, scans: list[Line], steps: list[Array], times: Array, start: Array) -> None:
    """A CARMEN log with odometry that goes on from scan to scan, as a robot has it."""
    rows, robot = [], start
    for number, scan in enumerate(scans):
        if number:
            step, since, until = steps[number - 1], times[number - 1], times[number]
            moments = np.linspace(since, until, len(step) + 1)[1:]
            rows += [
                _row("ODOM", compose(robot, pose), "0 0 0", at)
                for pose, at in zip(step[:-1], moments, strict=False)
            ]
            robot = compose(robot, step[-1])
        words = f"{len(scan.words)} {' '.join(scan.words)}"
        pose = " ".join(f"{value:.6f}" for value in robot)
        rows.append(f"FLASER {words} {pose} {pose} {times[number]:.6f} robot {times[number]:.6f}")
    _write(path, rows)


def _row(kind: str, pose: Array, rest: str, time: float) -> str:
    return f"{kind} {' '.join(f'{value:.6f}' for value in pose)} {rest} {time:.6f} robot {time:.6f}"


def _write(path: Path, rows: list[str]) -> None:
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
