"""The associations side by side: which poses each proposes for a scan, and what comes of them.

    .venv/bin/python benchmarks/association.py [--datasets FOLDER] [--only intel] [--scans 100]
        [--embedding ring] [--components 16] [--occlude 0.3] [--json OUT]
    .venv/bin/python benchmarks/association.py --pruning [--datasets FOLDER] [--json OUT]

recall: a candidate is right (0.5 m, 10 degrees). false: candidates that are not, one a neighbourhood. ahead:
how many of these are nearer than the right one (median; - where most lists lack it). top1, listed: after
verification and refinement. ms: CPU of the association alone, and of a scan. `--pruning`: the share of the
poses that are not searched because the error vector is too large in their region, and of the scans whose
right pose is among them. The datasets are not part of the project; by default they are looked for beside it.
Set OMP_NUM_THREADS=1.
"""

import argparse
import json
import math
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from build import office
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import read_map
from eigenscan.geometry.pose import compose, from_message, to_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.positions import free_positions
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.observation import ANALYSIS_TURN, Observation, observe
from eigenscan.projector.projection import find_candidates, project
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.shelf import WholeSet
from eigenscan.projector.site import SensorView, Site
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.metrics import WITHIN_M, WITHIN_RAD, errors, right
from single_scan import CASES, DATASETS, occluded, samples

SIMULATED = "office (simulated)"
CHOSEN = ("intel", "fr079", "guardian 3", "guardian 2 rear")
VARIANTS: dict[str, dict[str, Any]] = {
    "sweep": {"association": "sweep"},
    "sweep, 300 nearest": {"association": "sweep", "candidates": 300},
    "cells": {"association": "cells"},
    "tree": {"association": "tree"},
    "connectivity": {"association": "connectivity"},
    "triangles": {"association": "triangles"},
    "triangles, margin 0": {"association": "triangles", "margin": 0},
    "tetrahedra": {"association": "tetrahedra"},
    "tetrahedra, margin 0": {"association": "tetrahedra", "margin": 0},
}
COLUMNS = (
    ("recall %", "recall", "{:.0f}", 100), ("false", "false", "{:.0f}", 1), ("ahead", "ahead", "{:.0f}", 1),
    ("top1 %", "top1", "{:.0f}", 100), ("listed %", "in_list", "{:.0f}", 100),
    ("assoc. ms", "association_ms", "{:.2f}", 1), ("scan ms", "scan_ms", "{:.1f}", 1),
    ("index MB", "index_mb", "{:.1f}", 1), ("kB / m2", "kb_per_m2", "{:.1f}", 1),
)  # fmt: skip


@dataclass(frozen=True)
class Asked:
    """A scan on the analysis grid and the true pose of its sensor."""

    seen: Observation
    truth: np.ndarray


def simulated(count: int, area: float = 470.0, occlude: float = 0.0) -> tuple[SiteModel, list[Asked]]:
    """An office, and scans of half a turn at half a degree, 2 cm of noise."""
    built = build_site(office(area), Plan(spacing=0.5))
    rng = np.random.default_rng(0)
    free = free_positions(built.grid, 0.1, 0.35).points
    poses = np.column_stack([rng.permutation(free)[:count], rng.uniform(-np.pi, np.pi, count)])
    bearings = np.deg2rad(np.arange(361) * 0.5 - 90.0)
    ranges = RayCaster.of(built.grid).cast(poses, bearings, 30.0) + rng.normal(0, 0.02, (count, 361))
    scans = [
        Scan(
            mount=to_message(np.zeros(3)), angle_min=bearings[0], angle_increment=np.deg2rad(0.5),
            range_min=0.05, range_max=30.0, ranges=row.tolist(),
        )
        for row in ranges
    ]  # fmt: skip
    return built, asked(scans, poses, occlude)


def asked(scans: list[Scan], truths: Iterable[np.ndarray], occlude: float) -> list[Asked]:
    """With a share of the beams occluded."""
    seen = [observe(occluded(scan, occlude, i) if occlude else scan) for i, scan in enumerate(scans)]
    return [Asked(one, truth) for one, truth in zip(seen, truths, strict=True)]


def recorded(datasets: Path, name: str, count: int, occlude: float = 0.0) -> tuple[SiteModel, list[Asked]]:
    case = next(case for case in CASES if case.name == name)
    built = build_site(read_map(datasets / case.folder / "map.yaml"), Plan(spacing=0.5))
    chosen = samples(datasets, case, count)
    truths = [compose(s.truth, from_message(s.scan.mount)) for s in chosen]
    return built, asked([s.scan for s in chosen], truths, occlude)


def whole(built: SiteModel) -> WholeSet:
    return WholeSet("", built.frame_id, built.grid, tuple(built.regions), built.grid.free_area)


def candidates(site: Site, view: SensorView, seen: Observation, count: int) -> tuple[np.ndarray, float]:
    """Poses (k, 3) of the sensor, nearest first, and the association's CPU ms."""
    projected = project(view, seen, seen.used)
    squares = projected.error_energy**2 * (view.embedding.channels * len(seen.coarse))
    before = time.process_time()
    found = view.association.nearest(projected.coefficients, squares, count)
    spent = (time.process_time() - before) * 1e3
    position, window = (of[found.rows].astype(np.int64) for of in (view.row_position, view.row_window))
    at = lattice_poses(site.lattice.positions, position, window, ANALYSIS_TURN, seen.sensor.angle_min)
    return at + found.offsets, spent


def hits(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return right(*errors(poses, np.broadcast_to(truth, poses.shape)))


def apart(poses: np.ndarray) -> np.ndarray:
    """One pose of each neighbourhood, nearest first."""
    order = np.arange(len(poses))
    return poses[best_of_neighbourhoods(poses, order, WITHIN_M, WITHIN_RAD, max(len(poses), 1))]


def judge(built: SiteModel, scans: list[Asked], settings: ProjectorSettings) -> dict[str, Any]:
    site = Site(whole(built), settings)
    view = site.view(scans[0].seen.sensor)
    find_candidates(site, view, scans[0].seen, settings)
    recall, false, ahead, top1, listed, alone, scan = [], [], [], [], [], [], []
    for one in scans:
        poses, spent = candidates(site, view, one.seen, settings.candidates)
        alone.append(spent)
        recall.append(bool(hits(poses, one.truth).any()))
        hit = hits(apart(poses), one.truth)
        false.append(np.count_nonzero(~hit))
        ahead.append(float(np.argmax(hit)) if hit.any() else math.inf)
        before = time.process_time()
        final = hits(find_candidates(site, view, one.seen, settings).poses, one.truth)
        scan.append((time.process_time() - before) * 1e3)
        top1.append(bool(final[:1].any()))
        listed.append(bool(final.any()))
    middle = float(np.median(ahead))
    return {
        "n": len(scans), "recall": np.mean(recall), "false": np.mean(false),
        "ahead": middle if np.isfinite(middle) else None,
        "top1": np.mean(top1), "in_list": np.mean(listed),
        "association_ms": np.median(alone), "scan_ms": np.median(scan),
        "index_mb": view.association.nbytes / 1e6,
        "kb_per_m2": view.association.nbytes / 1e3 / built.grid.free_area,
    }  # fmt: skip


def pruning(built: SiteModel, scans: list[Asked]) -> dict[str, float]:
    """Share of the poses that are not searched, and of the scans that lose all right ones by it."""
    site = Site(whole(built), ProjectorSettings())
    view = site.view(scans[0].seen.sensor)
    rows = np.arange(view.bounds[-1])
    position, window = view.row_position.astype(np.int64), view.row_window.astype(np.int64)
    region = np.searchsorted(view.bounds, rows, side="right") - 1
    skipped, lost = [], []
    for one in scans:
        searched = project(view, one.seen, one.seen.used).searched[region]
        at = lattice_poses(site.lattice.positions, position, window, ANALYSIS_TURN, one.seen.sensor.angle_min)
        skipped.append(1.0 - searched.mean())
        hit = hits(at, one.truth)
        lost.append(bool(hit.any() and not searched[hit].any()))
    return {"n": len(scans), "pruned": float(np.mean(skipped)), "lost": float(np.mean(lost))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", default="", help="cases whose name holds this")
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--embedding", choices=("ring", "range"), action="append", help="both by default")
    parser.add_argument(
        "--components", type=int, default=ProjectorSettings.model_fields["components"].default
    )
    parser.add_argument("--occlude", type=float, default=0.0, help="share of the beams, in random runs")
    parser.add_argument("--pruning", action="store_true", help="what region pruning skips and loses")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = show_pruning(options) if options.pruning else show_associations(options)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1, default=float))


def show_pruning(options: argparse.Namespace) -> list[dict[str, Any]]:
    rows = []
    print("case | occluded % | scans | poses pruned % | right pose pruned %")
    for case in CASES:
        for share in (0.0, 0.3):
            if options.only in case.name:
                row = pruning(*recorded(options.datasets, case.name, options.scans, share))
                rows.append({"case": case.name, "occluded": share, **row})
                shares = f"{100 * row['pruned']:.1f} | {100 * row['lost']:.1f}"
                print(f"{case.name} | {100 * share:.0f} | {row['n']} | {shares}", flush=True)
    return rows


def show_associations(options: argparse.Namespace) -> list[dict[str, Any]]:
    rows = []
    print(" | ".join(["case", "embedding", "association", *(name for name, *_ in COLUMNS)]))
    for name in (*CHOSEN, SIMULATED):
        if options.only not in name:
            continue
        built, scans = (
            simulated(options.scans, occlude=options.occlude)
            if name == SIMULATED
            else recorded(options.datasets, name, options.scans, options.occlude)
        )
        for embedding in options.embedding or ("ring", "range"):
            for variant, chosen in VARIANTS.items():
                settings = ProjectorSettings.model_validate(
                    {"embedding": embedding, "components": options.components, **chosen}
                )
                row = judge(built, scans, settings)
                rows.append({"case": name, "embedding": embedding, "variant": variant, **row})
                cells = [
                    "-" if row[key] is None else form.format(row[key] * scale)
                    for _, key, form, scale in COLUMNS
                ]
                print(" | ".join([name, embedding, variant, *cells]), flush=True)
    return rows


if __name__ == "__main__":
    main()
