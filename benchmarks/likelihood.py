"""What a support is worth: log_likelihood by maximum likelihood, and how honest it is.

    .venv/bin/python benchmarks/likelihood.py [--datasets FOLDER] [--scans 100] [--fit intel,jarvis]
        [--fitted] [--json OUT]

Every scan is asked for in its own map, as it is and with 30 % of its beams hidden, and in the maps of the
other buildings. A listed pose has the prior mass of its own volume, (2 pi)^3/2 sqrt|C| of area times a full
turn; a pose that is not listed and a place off the map have a mass of 1 each and a likelihood of 1. The
numbers are fitted on the buildings of `--fit`; the others are held out. The tables are of the numbers in use,
with `--fitted` of those just found: of the poses given a probability, the share that is right, in one's own
map alone and with as many scans of other buildings among them.
"""

import argparse
import itertools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import read_map
from eigenscan.geometry.pose import compose, from_message
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector import likelihood
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from scipy.optimize import minimize
from single_scan import CASES, DATASETS, Case, is_right, occluded, samples, whole_set

HIDDEN = (0.0, 0.3)
LONGEST = 30
BINS = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99, 1.0)
ELSEWHERE = 2.0
"""Mass of what is not listed: the rest of the map, and the world off it."""


@dataclass(frozen=True)
class Lists:
    """n lists of up to LONGEST poses, NaN beyond: supports, ln of the prior mass, and which are right."""

    supports: np.ndarray
    mass: np.ndarray
    right: np.ndarray

    @classmethod
    def joined(cls, parts: list["Lists"]) -> "Lists":
        return cls(*(np.concatenate([getattr(p, n) for p in parts]) for n in ("supports", "mass", "right")))

    def posterior(self, numbers: np.ndarray) -> np.ndarray:
        """Probability (n, LONGEST) of each listed pose, and of none of them in one more column."""
        nats, strange, similar = numbers
        last = np.count_nonzero(np.isfinite(self.supports), axis=1) - 1
        rank = np.clip(last, 0, likelihood.ORDINARY_RANK)[:, None]
        ordinary = np.maximum(np.take_along_axis(self.supports, rank, axis=1), 0.0)
        odds = nats * (self.supports - strange - similar * ordinary) + self.mass
        odds = np.column_stack([odds, np.full(len(odds), np.log(ELSEWHERE))])
        odds[np.isnan(odds)] = -np.inf
        weight = np.exp(odds - odds.max(axis=1, keepdims=True))
        return np.asarray(weight / weight.sum(axis=1, keepdims=True))

    def surprise(self, numbers: np.ndarray) -> float:
        """Mean of -ln of the probability given to what is true."""
        given = self.posterior(numbers)
        none = ~self.right.any(axis=1)
        return float(
            -np.log(np.maximum((given * np.column_stack([self.right, none])).sum(axis=1), 1e-12)).mean()
        )


def ask(site: Site, scans: list[tuple[Any, np.ndarray | None]]) -> Lists:
    """Lists for scans and their true base poses, None in a foreign building."""
    settings = ProjectorSettings()
    shape = (len(scans), LONGEST)
    lists = Lists(np.full(shape, np.nan), np.full(shape, np.nan), np.zeros(shape, dtype=bool))
    for i, (scan, truth) in enumerate(scans):
        seen = observe(scan)
        found = find_candidates(site, site.view(seen.sensor), seen, settings)
        n = len(found.poses)
        volume = 1.5 * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(found.covariances)[1]
        lists.supports[i, :n] = found.supports
        lists.mass[i, :n] = volume - np.log(site.area(None) * 2 * np.pi)
        if truth is not None:
            lists.right[i, :n] = is_right(found.poses, compose(truth, from_message(scan.mount)))
    return lists


def collect(datasets: Path, count: int) -> dict[str, dict[str, list[Lists]]]:
    """Of each building the lists of its own scans and of foreign ones, a case or a stranger each."""
    found = {}
    for folder in dict.fromkeys(case.folder for case in CASES):
        built = build_site(read_map(datasets / folder / "map.yaml"), Plan())
        site = Site(whole_set(built), ProjectorSettings())

        def taken(case: Case) -> list[Any]:
            return samples(datasets, case, count)

        own = [
            ask(site, [(occluded(s.scan, share, i), s.truth) for i, s in enumerate(taken(case))])
            for case in CASES
            if case.folder == folder
            for share in HIDDEN
        ]
        foreign = [ask(site, [(s.scan, None) for s in taken(c)]) for c in CASES if c.folder != folder]
        found[folder] = {"own": own, "foreign": foreign}
        print(f"{folder}: asked", flush=True)
    return found


def fit(found: dict[str, dict[str, list[Lists]]], folders: list[str]) -> np.ndarray:
    """The numbers under which the folders' scans are least surprising; own and foreign weigh alike."""
    parts = [found[folder][kind] for folder in folders for kind in ("own", "foreign")]
    best = minimize(  # type: ignore[call-overload]
        lambda numbers: float(sum(np.mean([lists.surprise(numbers) for lists in part]) for part in parts)),
        np.array([likelihood.NATS, likelihood.STRANGE, likelihood.SIMILAR]),
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-5},
    )
    return np.asarray(best.x)


def reliability(own: Lists, foreign: Lists, numbers: np.ndarray) -> list[dict[str, float]]:
    """By the probability given to the first pose: how many, and the share that is right."""
    first, strange = own.posterior(numbers)[:, 0], foreign.posterior(numbers)[:, 0]
    rows = []
    for low, high in itertools.pairwise(BINS):
        held = (first >= low) & ((first < high) | (high == 1.0))
        false = (strange >= low) & ((strange < high) | (high == 1.0))
        hits = np.count_nonzero(own.right[held, 0])
        share = np.count_nonzero(false) / len(strange) * len(first)
        rows.append(
            {
                "from": low,
                "n": int(held.sum()),
                "given": float(first[held].mean()) if held.any() else np.nan,
                "right": hits / held.sum() if held.any() else np.nan,
                "right_with_foreign": hits / (held.sum() + share) if held.sum() + share else np.nan,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--fit", default="intel,jarvis")
    parser.add_argument("--fitted", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = collect(options.datasets, options.scans)
    best = fit(found, options.fit.split(","))
    used = np.array([likelihood.NATS, likelihood.STRANGE, likelihood.SIMILAR])
    print(f"NATS, STRANGE, SIMILAR: {used} in use, {np.round(best, 3)} fitted on {options.fit}")
    numbers = best if options.fitted else used
    figures: dict[str, Any] = {"used": used.tolist(), "fitted": best.tolist(), "on": options.fit}
    for folder, kinds in found.items():
        foreign = Lists.joined(kinds["foreign"])
        strange = foreign.posterior(numbers)[:, 0]
        for share, label in zip(HIDDEN, ("as they are", "30 % hidden"), strict=True):
            own = Lists.joined(kinds["own"][HIDDEN.index(share) :: len(HIDDEN)])
            rows = reliability(own, foreign, numbers)
            figures[f"{folder}, {label}"] = {"reliability": rows, "foreign_max": strange.max()}
            print(f"{folder}, {label}; of foreign scans {np.mean(strange > 0.5):.1%} over 0.5")
            for row in rows:
                print("  " + "  ".join(f"{name} {value:.3g}" for name, value in row.items()), flush=True)
    if options.json:
        options.json.write_text(json.dumps(figures, indent=1, default=float))


if __name__ == "__main__":
    main()
