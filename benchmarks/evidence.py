"""What a hypothesis is worth to a track that predicted it: right tracks beside wrong ones, on real logs.

    .venv/bin/python benchmarks/evidence.py [--datasets FOLDER] [--only intel] [--json OUT]
        [--way "30 % of the walls missing"] [--buildings FOLDER]

A track is begun at each hypothesis of a scan that is worth it, and followed by the true motion to the scan
half a metre or half a radian on. There it has a hypothesis of some log-likelihood L, by some nats ahead of
the next place, or none. The tables are ln p(that | the track was right) / p(that | it was wrong): first of
wrong tracks whose list has the right place, then of those whose list lacks it, as off the map, where a
similar place may well be ahead. The tracker's own figures (services/tracker, evidence.py) stand beside them.

Then how many of a list's ten likeliest go on in the next list, and how many where the robot was carried to
another place in between: what shows that it was (services/tracker, continuity.py).

And the rates of hiding and showing that make what the true pose meets most likely, by these figures.

And how often one list leaves out what the lists before and after it have (services/tracker, belief.py); and
of the true poses that a list leaves out, how many are left out 1 to 8 steps on, and all the way until there.

And aliases: of the wrong tracks those that look right, by this table; and how many of these still do so 1 to
15 steps on. Were scans from new places independent evidence, no more of them would than of all.

And by how much the hypothesis nearest to the true pose errs, by its likelihood: squared, in sigmas of the
covariance that the projector publishes, three of them; the mean of errors of at most CAPPED. The tracker
makes poor fits' covariances larger by that (services/tracker, observation.py). `--way`: on a map made worse
(benchmarks/worse_maps.py).

And how likely the best is that scans of another building get on this map: a robot off the map gets the like.

And of the lists that have the right place, one each half metre: how often their best place is the right one,
by how many nats it is ahead of the next. Beside it how likely that is by the likelihoods, and by the tracker,
to which what is ahead is likelier by as much again.

The datasets are not part of the project; by default they are looked for beside it.
"""

import argparse
import itertools
import json
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.circle import difference
from eigenscan.geometry.gridmap import write_map
from eigenscan.geometry.pose import between, compose
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.tracker.belief import MISSES
from eigenscan.tracker.continuity import BY_CHANCE, COMPARED, LEAST, NEAR_M, goes_on
from eigenscan.tracker.covariance import mahalanobis_squared, residual
from eigenscan.tracker.evidence import (
    ALIASES,
    BEHIND,
    EMERGES,
    ENDS,
    HIDES,
    LEAD,
    MOST,
    SHOWN_YET_MISSED,
    SHOWS,
)
from eigenscan.tracker.observation import poorness
from eigenscan.tracker.odometry import Motion
from eigenscan.workbench.evaluation.metrics import errors, right
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.pipeline import Pipeline
from evaluate import DATASETS, buildings
from evaluate import Case as Listed
from maps import LOGS, Case, read_case, windows_of
from numpy.typing import NDArray
from scipy.optimize import minimize
from worse_maps import WAYS, Worse, stays

CASES = {one.name: one for one in LOGS if one.name not in ("jarvis", "olin")}
"""Logs that choices were made on; the others only judge."""
WORTH = 8.0
"""Log-likelihood from which on a hypothesis begins a track here."""
STEP_M, STEP_RAD = 0.5, 0.5
STRANGERS = 100
"""Scans of another building."""
LOOKS_RIGHT = 2.0
"""Nats by which a hypothesis speaks for its track, from which on the track looks right."""
GOES_ON = (1, 2, 4, 6, 10, 15)
STAYS_OUT = (1, 2, 4, 8)
AWAY_M = 3.0
"""A place nearer than this is none that a robot was carried to."""
LIKELIHOODS = np.array([-np.inf, 5.0, 7.0, 9.0, 11.0, 13.0, 15.0, np.inf])
AHEAD = np.array([-np.inf, -8.0, -5.0, -3.0, -1.0, 0.0, 1.0, 3.0, 5.0, np.inf])
LEADS = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, np.inf])
NEAREST_M, NEAREST_RAD, CAPPED = 1.0, np.radians(25.0), 60.0
"""Of the true pose, and the squared error, beyond which a hypothesis is of another place."""


@dataclass(frozen=True)
class Answer:
    """The list of one lidar's scan, poses (k, 3) with covariances (k, 3, 3), and the true pose (3,).

    `likelihoods` (k,), as logarithms.
    """

    lidar: str
    poses: np.ndarray
    covariances: np.ndarray
    likelihoods: np.ndarray
    truth: np.ndarray

    def near(self, pose: np.ndarray) -> np.ndarray:
        """Which hypotheses are within 0.5 m and 10 degrees of a pose, (k,)."""
        return right(*errors(self.poses, np.broadcast_to(pose, self.poses.shape)))

    def at(self, pose: np.ndarray) -> tuple[float, float] | None:
        """Log-likelihood of the likeliest hypothesis at a pose, and how far ahead it is; None without one."""
        there = self.near(pose) if len(self.poses) else np.zeros(0, dtype=bool)
        if not there.any():
            return None
        best = self.likelihoods[there].max()
        return float(best), float(best - self.likelihoods[~there].max(initial=0.0))


@cache
def opened(datasets: Path, listed: Listed) -> Case:
    """A log, its reference and its map."""
    return read_case(listed.name, datasets / listed.folder, listed.log, listed.reference)


def worsened(case: Case, way: str) -> tuple[Pipeline, Worse]:
    """A log's map made worse in this way, and the projector on it."""
    worse = WAYS[way](Worse(case.map, stays), case.reference.poses, zlib.crc32(way.encode()))
    with tempfile.TemporaryDirectory() as scratch:
        write_map(worse.grid, Path(scratch) / "map.yaml")
        return Pipeline(build(Path(scratch) / "map.yaml", MapbuilderSettings(), lambda _: None).models), worse


def strangers(pipeline: Pipeline, datasets: Path, name: str) -> list[float]:
    """Of scans of another building's log, the likelihoods of their lists' best on this map."""
    other = opened(datasets, CASES[next(one for one in ("intel", "fr079") if one != name)])
    raw = [each for own in windows_of(other) for each in other.log.between(own) if each.channel == SCAN_RAW]
    lists = [pipeline.answer(each).log_likelihoods for each in raw[:: max(1, len(raw) // STRANGERS)]]
    return [float(found.max(initial=0.0)) for found in lists]


def answers(pipeline: Pipeline, worse: Worse, case: Case) -> Iterator[list[Answer]]:
    """The lists of each window of a log that have a true pose, on its map made worse."""
    for window in windows_of(case):
        raw = [envelope for envelope in case.log.between(window) if envelope.channel == SCAN_RAW]
        stamps = [envelope.stamp for envelope in raw]
        truths, known = case.reference.at(stamps)
        truths = worse.move(truths)
        published = [
            (e.address["lidar"], pipeline.answer(e), truth)
            for e, truth, there in zip(raw, truths, known, strict=True)
            if there
        ]
        yield [
            Answer(lidar, a.poses, a.covariances, a.log_likelihoods, truth) for lidar, a, truth in published
        ]


def independent_way(scans: list[Answer]) -> np.ndarray:
    """How far the robot has come until each scan (n,), in steps that make a scan new evidence."""
    poses = np.array([scan.truth for scan in scans])
    moved = np.hypot(*np.diff(poses[:, :2], axis=0).T) / STEP_M
    turned = np.abs(difference(poses[1:, 2], poses[:-1, 2])) / STEP_RAD
    return np.append(0.0, np.cumsum(moved + turned))


def at_each_step(scans: list[Answer], begin: float = 0.0) -> NDArray[np.intp]:
    """Indices of the first scans that are as many steps on, from `begin` steps."""
    way = independent_way(scans)
    return np.unique(np.searchsorted(way, np.arange(begin, way[-1], 1.0)))


@dataclass
class Counts:
    """How often tracks had a hypothesis of a likelihood and lead, (L, A), and how often none."""

    listed: np.ndarray
    missed: int = 0

    @property
    def total(self) -> float:
        return float(self.listed.sum() + self.missed)


def follow(scans: list[Answer], right_tracks: Counts, beside: Counts, alone: Counts) -> None:
    """Counts what became of the tracks that each third scan begins.

    Wrong ones count in `beside` where the list has the right place, and in `alone` where it does not.
    """
    way = independent_way(scans)
    for first in range(0, len(scans), 3):
        later = int(np.searchsorted(way, way[first] + 1.0))
        if later >= len(scans) or not len(scans[later].poses) or not len(scans[first].poses):
            continue
        begun, seen = scans[first], scans[later]
        motion, is_right = between(begun.truth, seen.truth), begun.near(begun.truth)
        wrong_tracks = beside if seen.near(seen.truth).any() else alone
        for k in np.flatnonzero(begun.likelihoods >= WORTH):
            counts = right_tracks if is_right[k] else wrong_tracks
            found = seen.at(compose(begun.poses[k], motion))
            if found is None:
                counts.missed += 1
                continue
            best, lead = found
            row = np.searchsorted(LIKELIHOODS, best, side="right") - 1
            counts.listed[row, np.searchsorted(AHEAD, lead, side="right") - 1] += 1


def aliases(windows: list[list[Answer]]) -> dict[str, Any]:
    """Of wrong tracks how many look right, and of these how many do so later, by steps."""
    looked, counts = list[bool](), {steps: list[bool]() for steps in GOES_ON}
    for scans in windows:
        way = independent_way(scans) if len(scans) > 1 else np.zeros(1)
        firsts = np.searchsorted(way, np.arange(0.0, way[-1], 1.0))
        for first in firsts.tolist():
            begun = scans[first]
            for k in np.flatnonzero(begun.likelihoods >= WORTH):
                if begun.near(begun.truth)[k]:
                    continue
                looked.append(looks_right(begun, begun.poses[k]))
                if not looked[-1]:
                    continue
                for steps, later in counts.items():
                    then = int(np.searchsorted(way, way[first] + steps))
                    if then < len(scans):
                        pose = compose(begun.poses[k], between(begun.truth, scans[then].truth))
                        later.append(looks_right(scans[then], pose))
    go_on = {steps: float(np.mean(later)) if later else float("nan") for steps, later in counts.items()}
    return {"aliases": float(np.mean(looked)) if looked else float("nan"), "aliases_go_on": go_on}


def looks_right(scan: Answer, pose: np.ndarray) -> bool:
    """Whether a scan has a hypothesis at a pose that speaks for it."""
    return worth(scan, pose) >= LOOKS_RIGHT


def worth(scan: Answer, pose: np.ndarray) -> float:
    """What the tracker takes a scan's hypothesis at a pose for, in nats; or that it has none there."""
    found = scan.at(pose)
    if found is None:
        return SHOWN_YET_MISSED
    _, lead = found
    return float(np.clip((LEAD if lead > 0.0 else BEHIND) * lead, -MOST, MOST))


def hiding(windows: list[list[Answer]]) -> dict[str, float]:
    """The rates, a step, of hiding and showing that make what the true pose met most likely; nats a step."""
    met = [each for scans in windows if len(scans) > 1 for each in at_steps(scans)]

    def against(logarithms: NDArray[np.float64]) -> float:
        hides, shows = np.exp(logarithms).tolist()
        return -explained(met, hides, shows)

    found = minimize(against, np.log(np.array([HIDES, SHOWS])), method="Nelder-Mead")
    hides, shows = np.exp(found.x).tolist()
    steps = max(sum(len(each) for each in met), 1)
    return {
        "hides": hides,
        "shows": shows,
        "hiding_nats": -float(found.fun) / steps,
        "hiding_nats_of_the_tracker": explained(met, HIDES, SHOWS) / steps,
    }


def at_steps(scans: list[Answer]) -> Iterator[np.ndarray]:
    """The true pose's worth in nats at every step; twice, the second time half a step on."""
    for begin in (0.0, 0.5):
        yield np.array([worth(scans[k], scans[k].truth) for k in at_each_step(scans, begin)])


def explained(met: list[np.ndarray], hides: float, shows: float) -> float:
    """How much likelier tracks that hide and show at these rates, a step, make what was met, in nats."""
    hide, show, total = -np.expm1(-hides), -np.expm1(-shows), 0.0
    for nats in met:
        hidden = 0.0
        for ratio in np.exp(nats).tolist():
            hidden = hidden * (1.0 - show) + (1.0 - hidden) * hide
            total += float(np.log(likelier := hidden + (1.0 - hidden) * ratio))
            hidden /= likelier
    return total


def missing(windows: list[list[Answer]]) -> dict[str, float]:
    """Of lists between two from nearby that have the true pose, how many leave it out."""
    left_out = lists = 0
    for scans in windows:
        for lidar in {scan.lidar for scan in scans}:
            own = [scan for scan in scans if scan.lidar == lidar]
            for before, scan, after in zip(own, own[1:], own[2:], strict=False):
                near = np.hypot(*(after.truth - before.truth)[:2]) <= NEAR_M
                if near and before.near(before.truth).any() and after.near(after.truth).any():
                    lists, left_out = lists + 1, left_out + (not scan.near(scan.truth).any())
    return {"missing": left_out / max(lists, 1)}


def staying_out(windows: list[list[Answer]]) -> dict[int, float]:
    """Of the steps at which the true pose is not listed, after how many it is in none of the next ones."""
    found = {steps: list[bool]() for steps in STAYS_OUT}
    for scans in windows:
        if len(scans) < 2:
            continue
        out = np.array([scans[k].at(scans[k].truth) is None for k in at_each_step(scans)], dtype=bool)
        for steps, kept in found.items():
            kept += [bool(out[k : k + steps + 1].all()) for k in np.flatnonzero(out[:-steps])]
    return {steps: float(np.mean(kept)) if kept else float("nan") for steps, kept in found.items()}


def continuity(windows: list[list[Answer]]) -> dict[str, list[float]]:
    """Shares of lists of which 0 to COMPARED go on: in the next one, and in one at least AWAY_M off."""
    together, apart = np.zeros(COMPARED + 1), np.zeros(COMPARED + 1)
    for scans in windows:
        last = dict[str, Answer]()
        for after in scans:
            before, last[after.lidar] = last.get(after.lidar, after), after
            if before is after:
                continue
            x, y, turn = between(before.truth, after.truth)
            moved = Motion((x, y, turn), float(np.hypot(x, y)), abs(turn), 0.0, 0.0, 0.0, 0.0)
            count = goes_on(before.poses, after.poses, moved)
            if count is not None and moved.way <= NEAR_M:
                together[count] += 1
    places = [scans[at] for scans in windows if scans for at in (0, len(scans) // 2)]
    still = Motion((0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for before, after in itertools.permutations(places, 2):
        count = goes_on(before.poses, after.poses, still)
        if count is not None and np.hypot(*(after.truth - before.truth)[:2]) >= AWAY_M:
            apart[count] += 1
    return {name: (n / max(n.sum(), 1)).tolist() for name, n in (("together", together), ("apart", apart))}


def squared_errors(windows: list[list[Answer]]) -> list[float | None]:
    """By likelihood, the mean squared error, in sigmas, of hypotheses near the true pose; None of too few."""
    found = [list[float]() for _ in LIKELIHOODS[1:]]
    for scan in itertools.chain.from_iterable(windows):
        off = residual(scan.poses, scan.truth[None])
        near = (np.hypot(off[:, 0], off[:, 1]) < NEAREST_M) & (np.abs(off[:, 2]) < NEAREST_RAD)
        if near.any():
            best = int(np.argmax(near))
            row = int(np.searchsorted(LIKELIHOODS, scan.likelihoods[best], side="right")) - 1
            error = float(mahalanobis_squared(off[best][None], scan.covariances[best][None])[0])
            found[row].append(min(error, CAPPED))
    return [float(np.mean(errors)) if len(errors) >= 10 else None for errors in found]


def best_places(windows: list[list[Answer]]) -> list[dict[str, float]]:
    """By LEADS, of lists that have the right place: how many there are, and in how many it is the best.

    Beside that, in how many of them by the likelihoods alone, and by the tracker.
    """
    rows = list[tuple[float, bool, float, float]]()
    for scans in windows:
        for lidar in {scan.lidar for scan in scans}:
            own = [scan for scan in scans if scan.lidar == lidar]
            listed = (own[k] for k in at_each_step(own) if len(own[k].poses))
            rows += [stated(scan) for scan in listed if scan.near(scan.truth).any()]
    lead, *shares = np.array(rows, dtype=np.float64).reshape(-1, 4).T
    cell_of = np.searchsorted(LEADS, lead, side="right") - 1
    lists = np.bincount(cell_of, minlength=len(LEADS) - 1)
    right, likelihoods, tracker = (
        np.bincount(cell_of, share, len(lists)) / np.maximum(lists, 1) for share in shares
    )
    cells = zip(lists.tolist(), right.tolist(), likelihoods.tolist(), tracker.tolist(), strict=True)
    return [
        dict(zip(("lists", "right", "by_likelihoods", "by_tracker"), cell, strict=True)) for cell in cells
    ]


def stated(scan: Answer) -> tuple[float, bool, float, float]:
    """A list's lead, nats; whether its best place is right; how likely by likelihoods, and by the tracker."""
    left, found, best = scan.likelihoods.copy(), list[float](), int(np.argmax(scan.likelihoods))
    while np.isfinite(left).any():
        k = int(np.argmax(left))
        found.append(left[k])
        left[scan.near(scan.poses[k])] = -np.inf
    lead, others = found[0] - max(found[1:], default=0.0), np.logaddexp.reduce([*found[1:], 0.0]) - found[0]
    alone, tracker = (float(1.0 / (1.0 + np.exp(others - more))) for more in (0.0, min(lead, MOST)))
    return float(lead), bool(scan.near(scan.truth)[best]), alone, tracker


def ratio(true: Counts, false: Counts) -> dict[str, Any]:
    """Ln of the ratio for a hypothesis of each likelihood and lead, NaN of too few, and for none."""
    half = 0.5  # of a track, so that an empty cell is not infinite
    listed = np.log((true.listed + half) / (true.total + half))
    listed -= np.log((false.listed + half) / (false.total + half))
    listed[true.listed + false.listed < 10] = np.nan
    missed = np.log((true.missed + half) / (true.total + half))
    missed -= np.log((false.missed + half) / (false.total + half))
    return {"hypothesis": listed.tolist(), "missed": float(missed)}


def judge(case: str, windows: list[list[Answer]]) -> dict[str, Any]:
    shape = (len(LIKELIHOODS) - 1, len(AHEAD) - 1)
    true, beside, alone = (Counts(np.zeros(shape)) for _ in range(3))
    for scans in windows:
        follow(scans, true, beside, alone)
    return (
        {
            "case": case,
            "right_tracks": true.total,
            "wrong_tracks": {"listed": beside.total, "not_listed": alone.total},
            "ratio": {"listed": ratio(true, beside), "not_listed": ratio(true, alone)},
        }
        | hiding(windows)
        | missing(windows)
        | {"stays_out": staying_out(windows)}
        | continuity(windows)
        | aliases(windows)
        | {"squared_errors": squared_errors(windows), "best_places": best_places(windows)}
    )


def show(row: dict[str, Any]) -> None:
    print(f"\n{row['case']}: {row['right_tracks']:.0f} right tracks")
    print(f"a step: hides {row['hides']:.3f} (tracker {HIDES}), shows {row['shows']:.3f} ({SHOWS}), ", end="")
    print(f"{row['hiding_nats']:.3f} nats a step ({row['hiding_nats_of_the_tracker']:.3f})")
    print(f"left out between two lists that have it: {row['missing']:.1%} (tracker {MISSES:.1%})")
    remain = ", ".join(f"{steps} on {share:.0%}" for steps, share in row["stays_out"].items())
    tracker = ", ".join(f"{np.exp(-EMERGES * steps):.0%}" for steps in STAYS_OUT)
    print(f"of true poses that are left out, still left out: {remain} (tracker, whole map: {tracker})")
    for name, what in (("together", "of ten go on in the next list"), ("apart", "where carried away")):
        print(f"{what:<30} " + "".join(f"{share:>7.1%}" for share in row[name]))
    ratio = [max(BY_CHANCE - count, np.log(LEAST)) for count in range(COMPARED + 1)]
    print(f"{'tracker, ln of their ratio':<30} " + "".join(f"{nats:>+7.0f}" for nats in ratio))
    later = ", ".join(f"{steps} on {share:.0%}" for steps, share in row["aliases_go_on"].items())
    print(f"aliases: {row['aliases']:.1%} of wrong tracks (tracker {ALIASES:.1%}); {later}")
    print("  the tracker: " + ", ".join(f"{np.exp(-ENDS * steps):.0%}" for steps in GOES_ON))
    for name, what in (("listed", "has"), ("not_listed", "lacks")):
        print(f"beside {row['wrong_tracks'][name]:.0f} wrong tracks whose list {what} the right place")
        print("        L   ahead by " + "".join(f"{low:>8g}.." for low in AHEAD[:-1]))
        for low, ratios in zip(LIKELIHOODS[:-1], row["ratio"][name]["hypothesis"], strict=True):
            cells = "".join("         -" if np.isnan(r) else f"{r:>+10.1f}" for r in ratios)
            print(f"{low:>9g}..          {cells}")
        print(f"   missed {row['ratio'][name]['missed']:+.1f}")
    quantiles = ", ".join(f"{each:.1f}" for each in np.percentile(row["strangers"], [10, 50, 90]))
    print(f"scans of another building, their best: 10, 50, 90 % are below {quantiles}")
    print("best place ahead by   lists   right   by likelihoods   tracker")
    for low, cell in zip(LEADS, row["best_places"], strict=False):
        shares = cell["right"], cell["by_likelihoods"], cell["by_tracker"]
        print(f"{low:>9g}.. {cell['lists']:>16}" + "{:>8.0%}{:>17.0%}{:>10.0%}".format(*shares))
    divisor = np.exp(poorness((LIKELIHOODS[:-1] + LIKELIHOODS[1:]) / 2.0))
    print("squared error, 3 were right; what the tracker divides it by")
    for low, error, less in zip(LIKELIHOODS[:-1], row["squared_errors"], divisor, strict=True):
        print(f"{low:>9g}..   " + ("-" if error is None else f"{error:.1f}") + f" ({less:.1f})", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", default="")
    parser.add_argument("--way", default="exact", choices=list(WAYS), help="in which the map is made worse")
    parser.add_argument("--buildings", type=Path, help="logs of your own instead, as for evaluate.py")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    root, cases = options.datasets, list(CASES.values())
    if options.buildings:
        root, cases = options.buildings, buildings(options.buildings)
    print(f"the tracker: {LEAD} for each nat ahead, {BEHIND} behind, at most {MOST:g} either way")
    rows = []
    for listed in cases:
        if options.only in listed.name:
            case = opened(root, listed)
            pipeline, worse = worsened(case, options.way)
            found = judge(listed.name, list(answers(pipeline, worse, case)))
            rows.append(found | {"strangers": strangers(pipeline, options.datasets, listed.name)})
            show(rows[-1])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
