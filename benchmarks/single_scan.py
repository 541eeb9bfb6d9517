"""One scan, no prior: how often the projector's first pose is right, and what it costs.

    .venv/bin/python benchmarks/single_scan.py [--datasets FOLDER] [--only intel] [--scans 100]
        [--spacing 0.5] [--error 0] [--occlude 0.3] [--set association=tree] [--foreign] [--exhaustive]
        [--stages] [--json OUT]

`--foreign` adds the scans of the other buildings to each map, none of which may look like home. `--stages`
shows in what share of the scans each stage of the search still had the right pose, and how many wrong ones
beside it, one a neighbourhood; last, where a tracker asks for a place beside the right one. The datasets are
not part of the project; by default they are looked for beside it. CPU is process time: set OMP_NUM_THREADS=1.
"""

import argparse
import json
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.gridmap import read_map, to_message
from eigenscan.geometry.pose import compose, covariance_from_message, from_message
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.connectivity import best_of_neighbourhoods
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates, look_also
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.channels import MAP, MODEL, MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.exhaustive import Gallery, best_poses, gallery
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.metrics import WITHIN_M, WITHIN_RAD, errors, right
from eigenscan.workbench.evaluation.reference import NS, read_trajectory
from eigenscan.workbench.logs.log import LogOptions
from evaluate import DATASETS


@dataclass(frozen=True)
class Case:
    name: str
    folder: str
    log: str
    lidar: str
    own: bool = False


OFF = np.array([0.1, -0.1, 0.05])
"""m, m, rad, by which a track is off."""

CASES = (
    Case("intel", "intel", "log.clf.gz", "", own=True),
    Case("fr079", "fr079", "log.clf.gz", "", own=True),
    Case("jarvis nav", "jarvis", "jarvis_complex_path_fast.bag", "/driver_laser_navigation/laser_scan"),
    Case("guardian 3", "guardian", "guardian_3.bag", "/scan"),
    Case("guardian 3 rear", "guardian", "guardian_3.bag", "/hokuyo_back_scan"),
    Case("guardian 2", "guardian", "guardian_controller_2.bag", "/scan"),
    Case("guardian 2 rear", "guardian", "guardian_controller_2.bag", "/hokuyo_back_scan"),
    Case("olin", "olin_mac", "rosbag2", "/scan"),
)


@dataclass(frozen=True)
class Sample:
    """One canonical scan and the true pose of the base."""

    scan: Scan
    truth: np.ndarray


@cache
def samples(datasets: Path, case: Case, count: int) -> list[Sample]:
    folder = datasets / case.folder
    log = read_log(folder / case.log, LogOptions(lidars=(case.lidar,) if case.lidar else ()), lambda _: None)
    reference = read_trajectory(folder / (case.log.split(".")[0] + ".tum"))
    if case.own:
        times = np.loadtxt(folder / "single_scans.csv", skiprows=1) * NS
        stamps = times.astype(np.int64)
    else:
        stamps = log.scans[np.linspace(0, len(log.scans) - 1, count).astype(np.int64)]
    found = [scan for stamp in stamps[:count] if (scan := log.nearest_scan(int(stamp), 1e-3)) is not None]
    truths, known = reference.at([scan.stamp for scan in found])
    kept = [(Log.canonical(s.envelope), t) for s, t, there in zip(found, truths, known, strict=True) if there]
    return [Sample(scan, truth) for scan, truth in kept if scan is not None]


def occluded(scan: Scan, share: float, seed: int) -> Scan:
    """Random runs of beams cut short by something near, until `share` of them is."""
    if not share:
        return scan
    rng = np.random.default_rng(seed)
    ranges = np.array(scan.ranges)
    hidden = np.zeros(len(ranges), dtype=bool)
    while hidden.mean() < share:
        run = (rng.integers(len(ranges)) + np.arange(int(rng.uniform(4, 16) * len(ranges) / 180))) % len(
            ranges
        )
        ranges[run] = np.fmin(ranges[run], rng.uniform(0.4, 1.5))
        hidden[run] = True
    other = Scan()
    other.CopyFrom(scan)
    other.ranges[:] = ranges.tolist()
    return other


def projector(site: SiteModel, settings: ProjectorSettings) -> ProjectorCore:
    core = ProjectorCore(settings)
    core.handle(Envelope(MAP, {"site": "s"}, to_message(site.grid, site.frame_id)))
    for model in site.regions:
        core.handle(Envelope(MODEL, {"site": "s", "region": model.region}, model.to_message()))
    core.handle(Envelope(MODEL_SET, {"site": "s"}, site.to_message()))
    return core


def ask(core: ProjectorCore, scan: Scan) -> tuple[Hypotheses, float]:
    """Answer and CPU ms."""
    envelope = Envelope(SCAN, {"site": "s", "robot": "r", "lidar": "l"}, scan)
    before = time.process_time()
    published = list(core.handle(envelope))
    return published[0].open(Hypotheses), (time.process_time() - before) * 1e3


def confidence_of(message: Hypotheses) -> float:
    """Probability of the first pose: the map and the world off it are as likely before the scan, and a pose
    has the share of the map that its own volume is, (2 pi)^3/2 sqrt|C|.
    """
    if not message.hypotheses:
        return 0.0
    C = np.array([covariance_from_message(h.covariance) for h in message.hypotheses])
    share = 1.5 * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(C)[1]
    share -= np.log(message.searched_area_m2 * 2 * np.pi)
    odds = np.array([h.log_likelihood for h in message.hypotheses]) + share
    elsewhere = [0.0, message.unlisted_log_likelihood]
    return float(np.exp(odds[0] - np.logaddexp.reduce([*odds, *elsewhere])))


def judge(core: ProjectorCore, chosen: list[Sample], share: float) -> dict[str, Any]:
    started = time.perf_counter()
    ask(core, chosen[0].scan)
    first_scan_s = time.perf_counter() - started
    first, listed, length, cpu, nees, off, confidence = [], [], [], [], [], [], []
    for number, sample in enumerate(chosen):
        message, spent = ask(core, occluded(sample.scan, share, number))
        cpu.append(spent)
        poses = np.array([from_message(h.pose) for h in message.hypotheses]).reshape(-1, 3)
        away, turn = errors(poses, np.broadcast_to(sample.truth, poses.shape))
        hit = right(away, turn)
        first.append(bool(hit[:1].any()))
        listed.append(bool(hit.any()))
        length.append(len(hit))
        confidence.append(confidence_of(message))
        if first[-1]:
            error = poses[0] - sample.truth
            error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
            nees.append(
                error @ np.linalg.solve(covariance_from_message(message.hypotheses[0].covariance), error)
            )
            off.append(float(away[0]))
    sure = np.array(confidence) > 0.9
    return {
        "n": len(chosen), "top1": np.mean(first), "in_list": np.mean(listed), "list_length": np.mean(length),
        "median_error_m": np.median(off) if off else None,
        "nees_mean": np.mean(nees) if nees else None, "nees_median": np.median(nees) if nees else None,
        "sure": np.mean(sure), "sure_right": np.mean(np.array(first)[sure]) if sure.any() else None,
        "cpu_ms": {"median": np.median(cpu), "p99": np.percentile(cpu, 99)}, "first_scan_s": first_scan_s,
    }  # fmt: skip


def judge_exhaustive(
    shown: Gallery, core: ProjectorCore, chosen: list[Sample], share: float
) -> dict[str, Any]:
    """The exhaustive comparison; and how often, where one of its 30 best places is right, a listed one is."""
    hits, cpu, listed = [], [], []
    for number, sample in enumerate(chosen):
        scan = occluded(sample.scan, share, number)
        ranges = np.asarray(scan.ranges, dtype=np.float64)
        directions = scan.angle_min + scan.angle_increment * np.arange(len(ranges), dtype=np.float64)
        reached = shown.up_to(scan.range_max)
        before = time.process_time()
        poses = best_poses(reached, ranges, directions, from_message(scan.mount))
        cpu.append((time.process_time() - before) * 1e3)
        best = poses[best_of_neighbourhoods(poses, np.arange(len(poses)), 0.25, np.deg2rad(5.0), 30)]
        hits.append(bool(is_right(best[:1], sample.truth).any()))
        if is_right(best, sample.truth).any():
            published = np.array([from_message(h.pose) for h in ask(core, scan)[0].hypotheses]).reshape(-1, 3)
            listed.append(bool(is_right(published, sample.truth).any()))
    return {
        "exhaustive_top1": np.mean(hits), "exhaustive_listed": len(listed) / len(chosen),
        "listed_where_exhaustive": np.mean(listed), "exhaustive_cpu_ms": np.median(cpu[1:]),
    }  # fmt: skip


def foreign_confidence(core: ProjectorCore, strangers: list[Sample]) -> dict[str, Any]:
    """The posterior of the best pose for scans of other buildings."""
    best = []
    for sample in strangers:
        best.append(confidence_of(ask(core, sample.scan)[0]))
    return {
        "foreign_n": len(best),
        "foreign_over_half": np.mean(np.array(best) > 0.5),
        "foreign_max": max(best),
    }


def is_right(poses: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Which poses (n, 3) are within 0.5 m and 10 degrees of the truth (3,)."""
    return right(*errors(poses, np.broadcast_to(truth, poses.shape)))


def recall_by_stage(
    built: SiteModel, settings: ProjectorSettings, chosen: list[Sample], share: float
) -> dict[str, Any]:
    """Share of the scans of which a stage still has a pose that is right; how many it has that are not."""
    models = WholeSet("", built.frame_id, built.grid, tuple(built.regions), built.grid.free_area)
    site = Site(models, settings)
    found: dict[str, list[float]] = {}
    for number, sample in enumerate(chosen):
        scan = occluded(sample.scan, share, number)
        seen, truth = observe(scan), compose(sample.truth, from_message(scan.mount))

        def trace(stage: str, poses: np.ndarray, truth: np.ndarray = truth) -> None:
            found.setdefault(stage, []).append(bool(is_right(poses, truth).any()))
            order = np.arange(len(poses))
            apart = poses[best_of_neighbourhoods(poses, order, WITHIN_M, WITHIN_RAD, len(poses) or 1)]
            found.setdefault(f"{stage}: wrong", []).append(float(np.sum(~is_right(apart, truth))))

        listed = find_candidates(site, site.view(seen.sensor), seen, settings, trace)
        beside = (truth + OFF)[None]
        trace("asked for", look_also(site, seen, listed, beside, settings.published).poses)
    return {stage: np.mean(hits) for stage, hits in found.items()}


def show(rows: list[dict[str, Any]]) -> None:
    columns = [name for name in rows[0] if name not in ("cpu_ms", "list_length", "nees_median")]
    columns += ["median", "p99"]
    flat = [{**row, **row["cpu_ms"]} for row in rows]
    print(" | ".join(columns))
    for row in flat:
        cells = [row.get(name) for name in columns]
        print(" | ".join(f"{v:.3g}" if isinstance(v, float) else str(v) for v in cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", default="")
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--spacing", type=float, default=0.5)
    parser.add_argument("--error", type=float, default=0.0, help="m, of adaptive positions")
    parser.add_argument("--occlude", type=float, default=0.0)
    parser.add_argument("--set", action="append", default=[], help="SETTING=VALUE of the projector")
    parser.add_argument("--foreign", action="store_true")
    parser.add_argument("--exhaustive", action="store_true")
    parser.add_argument("--stages", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    settings = ProjectorSettings.model_validate(dict(given.split("=", 1) for given in options.set))
    rows = []
    for case in CASES:
        if options.only not in case.name:
            continue
        site = build_site(
            read_map(options.datasets / case.folder / "map.yaml"),
            Plan(spacing=options.spacing, error=options.error),
        )
        core = projector(site, settings)
        chosen = samples(options.datasets, case, options.scans)
        row = {"case": case.name, "map_m2": site.grid.free_area, **judge(core, chosen, options.occlude)}
        if options.exhaustive:
            fine = build_site(site.grid, Plan(spacing=0.25))
            shown = gallery(
                np.concatenate([m.positions for m in fine.regions]),
                np.concatenate([m.panoramas for m in fine.regions]).astype(np.float64)[:, ::2],
                15.0,
            )
            row |= judge_exhaustive(shown, core, chosen, options.occlude)
        if options.foreign:
            others = [c for c in CASES if c.folder != case.folder]
            row |= foreign_confidence(core, [s for c in others for s in samples(options.datasets, c, 20)])
        if options.stages:
            row |= recall_by_stage(site, settings, chosen, options.occlude)
        rows.append(row)
        show(rows[-1:])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1, default=float))


if __name__ == "__main__":
    main()
