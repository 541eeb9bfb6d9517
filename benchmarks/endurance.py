"""An hour of driving through the whole pipeline: what memory and a scan's time do over it.

    .venv/bin/python benchmarks/endurance.py [--datasets FOLDER] [--hours 1] [--json OUT]

The intel log is played again and again with stamps that go on, and the robot is carried back at each start,
into scan-ingest, projector and tracker in one process; the log itself stays in memory. The datasets are not
part of the project; by default they are looked for beside it.
"""

import argparse
import json
import time
from collections.abc import Iterator
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import psutil
from eigenscan.cli.evaluation.kidnap import splice
from eigenscan.cli.evaluation.log import read_log
from eigenscan.cli.evaluation.models import build
from eigenscan.cli.evaluation.windows import Window
from eigenscan.cli.importers import LogOptions
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.loopback import Loopback
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings

DATASETS = Path(__file__).parents[1].parent / "shared/datasets"
PART_S = 300.0


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    place = options.datasets / "intel"
    log = read_log(place / "log.clf.gz", LogOptions(), lambda _: None)
    edges = range(int(log.scans.min()), int(log.scans.max()), int(PART_S * 1e9))
    parts = [log.between(Window(start, start + int(PART_S * 1e9))) for start in edges]
    loop = pipeline(place / "map.yaml")
    loop.start()
    rows, spent, began, part, spending = [], [], None, 1, 0.0
    print(f"{'minutes':>8} {'scans':>7} {'ms a scan':>10} {'p99':>6} {'resident MB':>12}")
    for envelope in going_on(parts):
        before = time.process_time()
        loop.hear(envelope)
        spending += (time.process_time() - before) * 1e3
        if envelope.channel != SCAN_RAW:
            continue
        spent.append(spending)
        spending = 0.0
        stamp = nanoseconds(envelope.open(RawScan).timestamp) * 1e-9
        began = stamp if began is None else began
        if stamp - began < part * PART_S:
            continue
        resident = psutil.Process().memory_info().rss / 1e6
        rows.append(
            {
                "minutes": (stamp - began) / 60,
                "scans": len(spent),
                "median_ms": float(np.median(spent)),
                "p99_ms": float(np.percentile(spent, 99)),
                "resident_mb": resident,
            }
        )
        print(
            f"{rows[-1]['minutes']:>8.1f} {len(spent):>7} {rows[-1]['median_ms']:>10.2f} "
            f"{rows[-1]['p99_ms']:>6.2f} {resident:>12.1f}",
            flush=True,
        )
        spent, part = [], part + 1
        if stamp - began >= options.hours * 3600:
            break
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
