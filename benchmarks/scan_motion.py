"""Motion between two scans: what a match costs, and what starting it again changes.

    .venv/bin/python benchmarks/scan_motion.py DATASETS [--only intel] [--matches 1200]

Scan-ingest matches scans of each log. Each match is made as it is, with its CPU time, then without and with
new starts along its worst determined direction. `support`: share of the points that fixes this direction;
from HELD_SUPPORT on scan-ingest does not start again. A row counts how far apart the last two end. The times
want a quiet machine, the counts do not.
"""

import argparse
import time
from itertools import pairwise
from pathlib import Path
from unittest import mock

import numpy as np
from eigenscan.ingest import motion, watch
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.motion import BEAMS, HELD_SUPPORT, NOISE, Motion, Points, Pose, motion_between
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.workbench.logs import LogOptions, open_log

LOGS = {
    "intel": "intel/log.clf.gz",
    "fr079": "fr079/log.clf.gz",
    "aces": "aces/log.clf.gz",
    "jarvis": "jarvis/jarvis_complex_path_fast.bag",
    "guardian": "guardian/guardian_3.bag",
    "olin": "olin_mac/rosbag2",
}
SUPPORTS = (-np.inf, 0.1, 0.15, 0.2, HELD_SUPPORT, 0.3, 0.35, 0.51)
APART_M = 0.02, 0.05


class EnoughError(Exception):
    """As many matches as were asked for."""


def matches(log: Path, most: int) -> list[tuple[Points, Points, Pose]]:
    """The first scans of a log that scan-ingest lays on earlier ones, with these and its guess."""
    found: list[tuple[Points, Points, Pose]] = []

    def noted(before: Points, after: Points, guess: Pose) -> Motion:
        found.append((before, after, guess))
        if len(found) == most:
            raise EnoughError
        return motion_between(before, after, guess)

    core = ScanIngestCore(ScanIngestSettings())
    with mock.patch.object(watch, "motion_between", noted):
        try:
            for envelope in open_log(log, LogOptions()).envelopes():
                if envelope.channel is SCAN_RAW:
                    list(core.handle(envelope))
        except EnoughError:
            pass
    return found


def compared(match: tuple[Points, Points, Pose]) -> tuple[float, float, float] | None:
    """CPU ms of a match, its support, and m to where it ends when started again; None: it does not fit."""
    began = time.thread_time()
    motion_between(*match)
    took = (time.thread_time() - began) * 1e3
    with mock.patch.object(motion, "HELD_SUPPORT", 0.0):  # never
        once = motion_between(*match)
    with mock.patch.object(motion, "HELD_SUPPORT", np.inf):  # always
        again = motion_between(*match)
    if not once.fits:
        return None
    ranged = int(np.count_nonzero(match[1].ranged))
    points = len(range(0, ranged, max(ranged // BEAMS, 1)))
    support = float(np.linalg.eigvalsh(once.information[:2, :2])[0]) * NOISE**2 / points
    return took, support, float(np.hypot(*np.subtract(once.delta, again.delta)[:2]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("datasets", type=Path)
    parser.add_argument("--only", action="append", choices=list(LOGS))
    parser.add_argument("--matches", type=int, default=1200, help="of each log, at most")
    given = parser.parse_args()
    rows = []
    for name in given.only or LOGS:
        of_log = [
            row for match in matches(given.datasets / LOGS[name], given.matches) if (row := compared(match))
        ]
        print(
            f"{name}: {len(of_log)} matches that fit, {np.mean([ms for ms, _, _ in of_log]):.2f} ms each",
            flush=True,
        )
        rows += of_log
    support, apart = np.array(rows)[:, 1:].T
    for low, high in [*pairwise(SUPPORTS), (-np.inf, HELD_SUPPORT), (HELD_SUPPORT, np.inf)]:
        ends = apart[(support >= low) & (support < high)]
        counts = ", ".join(
            f"{np.count_nonzero(ends > limit)} by more than {limit * 100:.0f} cm" for limit in APART_M
        )
        print(f"support {low:5.2f} to {high:4.2f}: {len(ends):5} matches, apart {counts}")


if __name__ == "__main__":
    main()
