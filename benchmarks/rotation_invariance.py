"""For full circles: search without the heading, by the magnitudes of a scan's spectrum, against the sweep.

    .venv/bin/python benchmarks/rotation_invariance.py [--area 700] [--scans 150] [--json OUT]

The magnitudes |F_k| of a full turn are the same at every heading, so that one point a position would do where
the eigenspace has one for each heading. Counted is how often a position within 0.5 m of the true one is among
the K nearest positions, with people before a share of the beams. Set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector import projection
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.focus import WHOLE
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from floors import floor, poses, scan_at
from projector import models

NEAREST = (1, 10, 50, 200)
KEPT = 64
"""Principal components of the magnitudes; more find no more."""
SETTINGS = ProjectorSettings()


def magnitudes(channels: np.ndarray) -> np.ndarray:
    """Spectra (n, F * (N / 2 + 1)) of channels (F, n, N), without their phases."""
    spectrum = np.abs(np.fft.rfft(channels, axis=2)).transpose(1, 0, 2)
    return spectrum.reshape(len(spectrum), -1).astype(np.float32)


class Invariant:
    """All positions by the principal components of their magnitudes."""

    def __init__(self, site: Site, view: SensorView) -> None:
        every = magnitudes(view.embedding(site.lattice.panoramas))
        self.mean = every.mean(axis=0)
        _, _, components = np.linalg.svd(every - self.mean, full_matrices=False)
        self.components = components[:KEPT]
        self.points = (every - self.mean) @ self.components.T
        self.embedding = view.embedding

    def nearest(self, seen: Observation) -> np.ndarray:
        ranges = np.where(np.isfinite(seen.coarse), seen.coarse, np.inf).astype(np.float32)
        own = (magnitudes(self.embedding(ranges)[:, None])[0] - self.mean) @ self.components.T
        return np.argsort(((self.points - own) ** 2).sum(axis=1))


def swept(view: SensorView, seen: Observation) -> np.ndarray:
    """Positions of the sweep's matches, nearest first, each once."""
    _, matches = projection._associate(view, seen, SETTINGS.candidates, WHOLE)
    positions = view.row_position[matches.rows[np.argsort(matches.squares)]]
    _, first = np.unique(positions, return_index=True)
    return positions[np.sort(first)]


def measure(options: argparse.Namespace, people: float) -> list[dict[str, Any]]:
    grid = floor(options.area)
    core, caster = ProjectorCore(SETTINGS), RayCaster.of(grid)
    for envelope in models(build_site(grid, Plan(spacing=0.5))):
        core.handle(envelope)
    site, truths = core._site, poses(grid, options.scans, 3)
    assert site is not None
    scans = [observe(scan_at(caster, truth, n, 2 * np.pi, people=people)) for n, truth in enumerate(truths)]
    view = site.view(scans[0].sensor)
    invariant = Invariant(site, view)
    rows = []
    for name, search in (("magnitudes", invariant.nearest), ("sweep", lambda seen: swept(view, seen))):
        search(scans[0])
        ranks, spent = [], []
        for seen, truth in zip(scans, truths, strict=True):
            began = time.perf_counter()
            order = search(seen)
            spent.append((time.perf_counter() - began) * 1e3)
            away = np.linalg.norm(site.lattice.positions[order] - truth[:2], axis=1)
            ranks.append(int(np.argmax(away < 0.5)) if (away < 0.5).any() else 10**9)
        recall = {f"among_{k}": float(np.mean(np.array(ranks) < k)) for k in NEAREST}
        rows.append({"people": people, "search": name, **recall, "ms": float(np.median(spent))})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--area", type=float, default=700.0)
    parser.add_argument("--scans", type=int, default=150)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = [row for people in (0.0, 0.1, 0.3) for row in measure(options, people)]
    print(" | ".join(rows[0]))
    for row in rows:
        print(" | ".join(f"{v:.3f}" if isinstance(v, float) else str(v) for v in row.values()))
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
