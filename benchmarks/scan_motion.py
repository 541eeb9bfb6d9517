"""Motion between two scans: what a match costs, what starting it again changes, and which are alike.

    .venv/bin/python benchmarks/scan_motion.py DATASETS [--only intel] [--matches 1200]

Scan-ingest matches scans of each log. Each match is made as it is, with its CPU time, then without and with
new starts along its worst determined direction. `support`: share of the points that fixes this direction;
from HELD_SUPPORT on scan-ingest does not start again. A row counts how far apart the last two end. The times
want a quiet machine, the counts do not.

Then somebody walks ahead of the robot, always as far away (`put_ahead`). A row counts matches that are sure
of the way and yet end elsewhere than without that person, as it is and where one thing may fix a direction.

Then the lidar sees no farther than some metres, as in a hall. `returns`: share of its beams that a match then
has, the least of both scans. A row counts matches that fit no longer, and that are sure and end elsewhere.

Neighbours that are not alike are compared at once. Scans of two places that are alike and hardly fit would be
found one scan late. `explained`: share of a scan that the other one has too, of neighbours and of two places.
"""

import argparse
import time
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from unittest import mock

import numpy as np
from eigenscan.ingest import motion, watch
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.laying import NOISE, Array
from eigenscan.ingest.motion import BEAMS, HELD_SUPPORT, Motion, Points, Pose, motion_between
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import FOLLOWS, SCAN_RAW
from eigenscan.workbench.logs import LogOptions, open_log

LOGS = {
    "intel": "intel/log.clf.gz",
    "fr079": "fr079/log.clf.gz",
    "aces": "aces/log.clf.gz",
    "jarvis": "jarvis/jarvis_complex_path_fast.bag",
    "guardian": "guardian/guardian_3.bag",
    "guardian 2": "guardian/guardian_controller_2.bag",
    "olin": "olin_mac/rosbag2",
}
SUPPORTS = (-np.inf, 0.1, 0.15, 0.2, HELD_SUPPORT, 0.3, 0.35, 0.51)
APART_M = 0.02, 0.05
AHEAD_M, WIDTH_M = (0.7, 1.0, 1.5), 0.5
"""m ahead of the lidar, where somebody of such a width walks."""
REACHES_M = 1.0, 1.5, 2.0, 3.0, 4.0
"""m that the lidar sees."""
RETURNS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.5)
ELSEWHERE_M, SURE_M = 0.1, 0.1
"""m, from which on a match ends elsewhere, and sigma up to which it is sure."""
APART_SCANS = 100
"""Between two of one lidar, from which they are taken to be of two places."""


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

    _play(log, mock.patch.object(watch, "motion_between", noted))
    return found


@dataclass
class Pairs:
    """Which pairs of scans are alike (n,), and the share (n,) of the later one that is explained."""

    alike: np.ndarray
    explained: np.ndarray


def similar_places(log: Path, most: int) -> tuple[Pairs, Pairs]:
    """Neighbours, and pairs of other places at random, of each lidar's first scans."""
    seen: dict[watch.Watch, list[Points]] = {}
    turning, receive = list[tuple[Points, Points, Pose]](), watch.Watch.receive

    def noted(
        lidar: watch.Watch, stamp: int, ranges: watch.Ranges, angle_min: float, step: float, mount: Pose
    ) -> object:
        own = seen.setdefault(lidar, [])
        points = motion.points_of(ranges.astype(float), angle_min, step, mount, stamp)
        if own:
            x, y, turn = (each * (stamp - own[-1].stamp) * 1e-9 for each in lidar._velocity)
            turning.append((own[-1], points, (x, y, turn)))
        own.append(points)
        if len(turning) >= most:
            raise EnoughError
        return receive(lidar, stamp, ranges, angle_min, step, mount)

    _play(log, mock.patch.object(watch.Watch, "receive", noted))
    rng, elsewhere = np.random.default_rng(0), list[tuple[Points, Points, Pose]]()
    for own in seen.values():
        for first, second in rng.integers(len(own), size=(1500, 2)).tolist():
            if abs(first - second) >= APART_SCANS:
                elsewhere.append((own[first], own[second], (0.0, 0.0, 0.0)))
    return _pairs(turning), _pairs(elsewhere)


def _pairs(found: list[tuple[Points, Points, Pose]]) -> Pairs:
    return Pairs(
        np.array([_alike(before, after, guess[2]) >= watch.ALIKE for before, after, guess in found]),
        np.array([motion_between(*pair).explained for pair in found]),
    )


def _alike(before: Points, after: Points, turn: float) -> float:
    first, second = (each.ranges.astype(np.float32) for each in (before, after))
    return watch.alike(first, second, round(turn / before.step))


def _play(log: Path, patched: AbstractContextManager[object]) -> None:
    core = ScanIngestCore(ScanIngestSettings())
    with patched, suppress(EnoughError):
        for envelope in open_log(log, LogOptions()).envelopes():
            if envelope.channel is SCAN_RAW:
                list(core.handle(envelope))


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


def with_ranges(scan: Points, ranges: Array) -> Points:
    """The same scan, had its beams met something else."""
    return motion.points_of(ranges, scan.angle_min, scan.step, scan.mount, scan.stamp)


def ends_elsewhere(alone: Motion, changed: Motion) -> bool:
    """Whether both matches fit, are sure of the way, and differ."""
    off = np.subtract(changed.delta, alone.delta)[:2]
    sure = [one.covariance[axis, axis] < SURE_M**2 for axis in (0, 1) for one in (alone, changed)]
    return bool(alone.fits and changed.fits and all(sure) and np.hypot(*off) > ELSEWHERE_M)


def put_ahead(match: tuple[Points, Points, Pose], metres: float) -> tuple[Points, Points, Pose]:
    """The same scans with somebody ahead of the lidar in both; the guess is that it stood."""
    walked = []
    for scan in match[:2]:
        angles = (scan.angle_min + scan.step * np.arange(len(scan.ranges)) + np.pi) % (2.0 * np.pi) - np.pi
        ranges = scan.ranges.copy()
        ranges[np.abs(angles) < np.arctan2(WIDTH_M / 2.0, metres)] = metres
        walked.append(with_ranges(scan, ranges))
    return walked[0], walked[1], (0.0, 0.0, 0.0)


def misled(match: tuple[Points, Points, Pose], metres: float) -> bool:
    """Whether the match is sure of a way that is another one without the person."""
    return ends_elsewhere(motion_between(*match), motion_between(*put_ahead(match, metres)))


def short_sighted(match: tuple[Points, Points, Pose]) -> list[tuple[float, bool, bool]]:
    """Of a match that fits, by reach of the lidar: returns, whether it fits no longer, or ends elsewhere."""
    alone, rows = motion_between(*match), []
    for metres in REACHES_M if alone.fits else ():
        seen = [with_ranges(scan, np.where(scan.ranges > metres, np.nan, scan.ranges)) for scan in match[:2]]
        near = motion_between(seen[0], seen[1], match[2])
        returns = float(min(scan.ranged.mean() for scan in seen))
        rows.append((returns, not near.fits, ends_elsewhere(alone, near)))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("datasets", type=Path)
    parser.add_argument("--only", action="append", choices=list(LOGS))
    parser.add_argument("--matches", type=int, default=1200, help="of each log, at most")
    parser.add_argument("--pairs", type=int, default=3000, help="neighbours of each log, at most")
    given = parser.parse_args()
    rows, pairs, short = [], np.zeros(4, dtype=int), list[tuple[float, bool, bool]]()
    print("log          explained: neighbours' least, 1 %, and below FOLLOWS; other places' above it")
    for name in given.only or LOGS:
        own = matches(given.datasets / LOGS[name], given.matches)
        of_log = [row for match in own if (row := compared(match))]
        print(
            f"{name}: {len(of_log)} matches that fit, {np.mean([ms for ms, _, _ in of_log]):.2f} ms each",
            flush=True,
        )
        rows += of_log
        short += [row for match in own for row in short_sighted(match)]
        for metres in AHEAD_M:
            as_it_is = sum(misled(match, metres) for match in own)
            with mock.patch.object(motion, "THING_M", 0.0):
                fixed_by_one = sum(misled(match, metres) for match in own)
            print(
                f"{name}: somebody {metres} m ahead misleads {as_it_is}, by one thing {fixed_by_one}",
                flush=True,
            )
        near, far = similar_places(given.datasets / LOGS[name], given.pairs)
        print(
            f"{name:24} {near.explained.min():.2f} {np.percentile(near.explained, 1):.2f} "
            f"{np.mean(near.explained < FOLLOWS):.2%} {np.mean(far.explained >= FOLLOWS):.1%}",
            flush=True,
        )
        late = far.alike & (far.explained < FOLLOWS)
        pairs += (len(near.alike), np.count_nonzero(~near.alike), len(far.alike), np.count_nonzero(late))
    print("neighbours {}, not alike {}; of other places {}, alike and hardly fitting {}".format(*pairs))
    returns, no_fit, elsewhere = np.array(short, dtype=np.float64).reshape(-1, 3).T
    for low, high in pairwise(RETURNS):
        these = (returns >= low) & (returns < high)
        if these.any():
            print(
                f"returns {low:4.0%} to {high:4.0%}: {these.sum():6} matches, "
                f"{no_fit[these].mean():5.1%} do not fit, {elsewhere[these].mean():5.2%} end elsewhere"
            )
    support, apart = np.array(rows)[:, 1:].T
    for low, high in [*pairwise(SUPPORTS), (-np.inf, HELD_SUPPORT), (HELD_SUPPORT, np.inf)]:
        ends = apart[(support >= low) & (support < high)]
        counts = ", ".join(
            f"{np.count_nonzero(ends > limit)} by more than {limit * 100:.0f} cm" for limit in APART_M
        )
        print(f"support {low:5.2f} to {high:4.2f}: {len(ends):5} matches, apart {counts}")


if __name__ == "__main__":
    main()
