"""An hour of driving through the whole pipeline: what memory and a scan's time do over it.

    .venv/bin/python benchmarks/endurance.py [--datasets FOLDER] [--hours 1] [--json OUT]
    .venv/bin/python benchmarks/endurance.py --simulated --hours 0.1

The intel log is played again and again with stamps that go on, and the robot is carried back at each start,
into scan-ingest, projector and tracker in one process; the log itself stays in memory. With --simulated it is
a drive through the demo's building with 40 scans a second of 361 beams each. The last column is what such a
robot takes of one core, in real time. The datasets are not part of the project; by default they are looked
for beside it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import psutil
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.loopback import Loopback
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.kidnap import splice
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions

DATASETS = Path(__file__).parents[1].parent / "shared/datasets"
EIGENSCAN = Path(sys.executable).parent / "eigenscan"
PART_S = 300.0
SIMULATED = {"--seconds": "300", "--rate": "40", "--beams": "361", "--people": "6", "--seed": "21"}


def going_on(parts: list[list[Envelope]]) -> Iterator[Envelope]:
    """The log without end, part by part, so that little of it is ever copied."""
    last = parts[0]
    yield from last
    for part in islice(cycle(parts), 1, None):
        last = splice(last, part).heard[len(last) :]
        yield from last


def pipeline(map_yaml: Path) -> Loopback:
    """All that a robot runs, in one process."""
    projector = ProjectorCore(ProjectorSettings())
    for model in build(map_yaml, 0.5, lambda _: None).models:
        if model.channel in projector.hears:
            list(projector.handle(model))
    return Loopback([ScanIngestCore(ScanIngestSettings()), projector, TrackerCore(TrackerSettings())])


def write_drive(folder: Path) -> tuple[Path, Path]:
    """Log and map of a simulated drive."""
    log, map_yaml = folder / "log.mcap", folder / "map.yaml"
    drive = [word for pair in SIMULATED.items() for word in pair]
    subprocess.run([EIGENSCAN, "simulate", "-o", log, "--save-map", map_yaml, *drive], check=True)
    return log, map_yaml


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--simulated", action="store_true", help="40 scans a second of 361 beams")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        place = options.datasets / "intel"
        at = write_drive(Path(scratch)) if options.simulated else (place / "log.clf.gz", place / "map.yaml")
        log, loop = read_log(at[0], LogOptions(), lambda _: None), pipeline(at[1])
    rows = play(log, loop, options.hours)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


def play(log: Log, loop: Loopback, hours: float) -> list[dict[str, float]]:
    """Plays a log for so long by its stamps; a row for each part."""
    print(f"{'minutes':>8} {'scans':>7} {'ms a scan':>10} {'p99':>6} {'resident MB':>12} {'of a core':>10}")
    rows: list[dict[str, float]] = []
    spent, began, part_began = list[float](), None, 0.0
    for stamp, ms in costs(log, loop):
        spent.append(ms)
        if began is None:
            began = part_began = stamp
        if stamp - began < (len(rows) + 1) * PART_S:
            continue
        rows.append(row(stamp - began, stamp - part_began, spent))
        spent, part_began = [], stamp
        if stamp - began >= hours * 3600:
            break
    return rows


def costs(log: Log, loop: Loopback) -> Iterator[tuple[float, float]]:
    """Stamp, s, of each scan, and the process time, ms, since the one before."""
    edges = range(int(log.scans.min()), int(log.scans.max()), int(PART_S * 1e9))
    loop.start()
    spent = 0.0
    for envelope in going_on([log.between(Window(start, start + int(PART_S * 1e9))) for start in edges]):
        before = time.process_time()
        loop.hear(envelope)
        spent += (time.process_time() - before) * 1e3
        if envelope.channel == SCAN_RAW:
            yield envelope.stamp * 1e-9, spent
            spent = 0.0


def row(since_s: float, part_s: float, spent_ms: list[float]) -> dict[str, float]:
    """Figures of one part, printed too."""
    figures = {
        "minutes": since_s / 60,
        "scans": len(spent_ms),
        "median_ms": float(np.median(spent_ms)),
        "p99_ms": float(np.percentile(spent_ms, 99)),
        "resident_mb": psutil.Process().memory_info().rss / 1e6,
        "core_share": sum(spent_ms) / 1e3 / part_s,
    }
    print(
        "{minutes:>8.1f} {scans:>7} {median_ms:>10.2f} {p99_ms:>6.2f} {resident_mb:>12.1f} "
        "{core_share:>10.1%}".format(**figures),
        flush=True,
    )
    return figures


if __name__ == "__main__":
    main()
