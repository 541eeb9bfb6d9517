"""Where the time of a scan goes, stage by stage, beside what this machine could do at best.

    .venv/bin/python benchmarks/projector.py [--area 700] [--spacing 0.5] [--scans 200] [--log intel]
        [--json OUT]

A floor of `--area` m2, a lidar of 180 degrees in steps of half a degree, 10 % of the beams on people.
Each scan is timed `--repeat` times and its fastest counts: that is what the work costs, not what else the
machine does. A stage's floor is the greater of its arithmetic at the rate of a matrix product and its
memory traffic at the rate of a sum over 64 MB. Also: the first scan of a new lidar, the start from the
models, and the memory by its owner. Set OMP_NUM_THREADS=1.

The last lines are of local fits, CPU ms a scan: whole searches and local fits of the same scans by turns, and
with --log the mix that a tracker with `local_fits` asks for over the first `--seconds` of a log.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import to_message
from eigenscan.geometry.pose import to_message as to_pose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector import core as core_module
from eigenscan.projector import projection, publishing
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.observation import observe
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up
from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL, MODEL_SET, SCAN, SEARCH
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE, Hypotheses, SearchRequest
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.wire import decode, encode
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.log import read_log
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.logs import LogOptions
from evaluate import CASES, DATASETS
from floors import floor, poses, scan_at

SITE = {"site": "s", "robot": "r", "lidar": "l"}
STAGES = {
    "observe": (core_module, "observe"),
    "foreground": (projection, "foreground"),
    "project": (projection, "project"),
    "associate": (projection, "_nearest"),
    "verify": (projection, "verify"),
    "one a neighbourhood": (projection, "best_of_neighbourhoods"),
    "refine": (projection, "fit"),
    "cast rays": (RayCaster, "cast"),
    "look at support": (projection, "doubts"),
    "polish and weigh": (projection, "weigh"),
    "hypotheses message": (core_module, "hypotheses_message"),
    "obstacles": (publishing, "find_obstacles"),
}


class Stopwatch:
    """Time spent in each stage, ms, since `clear`."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        for stage, (owner, name) in STAGES.items():
            setattr(owner, name, self._timed(stage, getattr(owner, name)))

    def _timed(self, stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*given: Any, **named: Any) -> Any:
            began = time.perf_counter()
            result = function(*given, **named)
            self.add(stage, began)
            return result

        return run

    def add(self, stage: str, began: float) -> None:
        self.spent[stage] = self.spent.get(stage, 0.0) + (time.perf_counter() - began) * 1e3


def models(built: Any) -> list[Envelope]:
    return [
        Envelope(MAP, SITE, to_message(built.grid, built.frame_id)),
        *(Envelope(MODEL, {**SITE, "region": m.region}, m.to_message()) for m in built.regions),
        Envelope(MODEL_SET, SITE, built.to_message()),
    ]


def one_scan(core: ProjectorCore, payload: bytes, watch: Stopwatch) -> Hypotheses:
    """From bytes to bytes, as the node does it."""
    watch.spent.clear()
    began = time.perf_counter()
    scan = decode(SCAN, payload)
    watch.add("decode", began)
    published = list(core.handle(Envelope(SCAN, SITE, scan)))
    packing = time.perf_counter()
    for envelope in published:
        encode(envelope.message)
    watch.add("encode", packing)
    watch.add("whole", began)
    return published[0].open(Hypotheses)


def is_right(message: Hypotheses, truth: np.ndarray) -> list[bool]:
    return [
        bool(
            np.hypot(h.pose.x - truth[0], h.pose.y - truth[1]) <= 0.5
            and abs((h.pose.theta - truth[2] + np.pi) % (2 * np.pi) - np.pi) <= np.deg2rad(10)
        )
        for h in message.hypotheses
    ]


def machine() -> dict[str, float]:
    """Rates of one core: Gflop/s of a matrix product, GB/s of a sum, both in single precision."""
    a, big = np.ones((768, 768), np.float32), np.ones(1 << 24, np.float32)
    flops, traffic = [], []
    for _ in range(7):
        began = time.perf_counter()
        a @ a
        flops.append(2 * 768**3 / (time.perf_counter() - began) / 1e9)
        began = time.perf_counter()
        big.sum()
        traffic.append(big.nbytes / (time.perf_counter() - began) / 1e9)
    return {"gflops": max(flops), "gbytes": max(traffic)}


def floors_of_stages(core: ProjectorCore, scan: Scan, rates: dict[str, float]) -> dict[str, float]:
    """The least time, ms, that the arithmetic and the memory traffic of the large stages allow."""
    site = core._site
    assert site is not None
    seen = observe(scan)
    view = site.view(seen.sensor).complete()
    settings = ProjectorSettings()
    beams, turned = len(seen.coarse), 3
    rows, components = int(view.bounds[-1]), view.spaces.prior.shape[1]
    slid = settings.refined * 6 * projection.SLIDE_POINTS
    work = {  # floating point operations, bytes
        "project": (2 * view.spaces.vectors.size, view.spaces.vectors.nbytes),
        "associate": (3 * rows * components, rows * components),
        "verify": (6 * settings.candidates * turned * beams, settings.candidates * (beams + 2) * 4),
        "refine": (45 * slid, 64 * slid // 6),
    }
    return {
        stage: max(flops / rates["gflops"], touched / rates["gbytes"]) * 1e-6
        for stage, (flops, touched) in work.items()
    }


def memory(core: ProjectorCore, built: Any) -> dict[str, float]:
    """kB for each m2 of free area, by owner; the models are kept to share them with the next set."""
    site = core._site
    assert site is not None
    view = next(iter(site._views.values()))
    parts = {
        "models": sum(m.ranges.nbytes for m in built.regions),
        "map, distances, rays": site.drawn.cells.nbytes + site.coarse_walls.cells.nbytes
        + site.caster.leap.nbytes + site.caster.grid.cells.nbytes,
        "panoramas": site.lattice.panoramas.nbytes + site.lattice.positions.nbytes
        + site.lattice.neighbours.nbytes,
        "index, a lidar": view.association.nbytes,
        "predicted scans, a lidar": view.windows.nbytes + view.leaves.nbytes,
        "eigenvectors, a lidar": view.spaces.vectors.nbytes,
    }  # fmt: skip
    area = built.grid.free_area
    return {name: size / 1e3 / area for name, size in parts.items()} | {
        "sum": sum(parts.values()) / 1e3 / area
    }


def measure(options: argparse.Namespace) -> dict[str, Any]:
    grid = floor(options.area)
    built = build_site(grid, Plan(spacing=options.spacing))
    received = [(e.channel, e.address, encode(e.message)) for e in models(built)]
    warm_up(ProjectorSettings())
    core = ProjectorCore(ProjectorSettings())
    began = time.perf_counter()
    for channel, address, payload in received:
        core.handle(Envelope(channel, address, decode(channel, payload)))
    start_s = time.perf_counter() - began
    caster = RayCaster.of(grid)
    truths = poses(grid, options.scans, 3)
    scans = [scan_at(caster, pose, number) for number, pose in enumerate(truths)]
    payloads = [encode(scan) for scan in scans]
    watch = Stopwatch()
    one_scan(core, payloads[0], watch)
    first_scan_s = watch.spent["whole"] / 1e3
    fastest: list[dict[str, float]] = [{} for _ in scans]
    right = []
    for repeat in range(options.repeat):
        for number, payload in enumerate(payloads):
            message = one_scan(core, payload, watch)
            if repeat == 0:
                right.append(is_right(message, truths[number]))
            if watch.spent["whole"] < fastest[number].get("whole", np.inf):
                fastest[number] = dict(watch.spent)
    names = ["decode", *STAGES, "encode"]
    columns = {name: np.array([spent.get(name, 0.0) for spent in fastest]) for name in names}
    whole = np.array([spent["whole"] for spent in fastest])
    # what lies between the stages
    columns["the rest"] = whole - sum(columns.values())
    rates = machine()
    least = floors_of_stages(core, scans[0], rates)
    local = whole_and_local(core, scans, truths, options.repeat)
    return {
        "local_fits": local | (mix(options.log, options.seconds) if options.log else {}),
        "free_m2": grid.free_area, "spacing_m": options.spacing, "regions": len(built.regions),
        "stages_ms": {
            name: {"median": float(np.median(spent)), "p99": float(np.percentile(spent, 99)),
                   "least": least.get(name)}
            for name, spent in {**columns, "whole": whole}.items()
        },
        "machine": rates, "start_s": start_s, "first_scan_s": first_scan_s,
        "kb_per_m2": memory(core, built),
        "top1": float(np.mean([r[:1] == [True] for r in right])),
        "in_list": float(np.mean([any(r) for r in right])),
    }  # fmt: skip


def whole_and_local(
    core: ProjectorCore, scans: list[Scan], truths: np.ndarray, repeat: int
) -> dict[str, float]:
    """CPU ms of a scan by a whole search and by a local fit: median over the scans of the fastest."""
    fastest = np.full((2, len(scans)), np.inf)
    time_ns = 10**18
    for _ in range(repeat):
        for number, (scan, truth) in enumerate(zip(scans, truths, strict=True)):
            for local in (False, True):
                time_ns += 100_000_000
                again = Scan.FromString(scan.SerializeToString())
                again.timestamp.CopyFrom(stamp(time_ns))
                began = time.process_time_ns()
                (first, *_) = [*core.handle(Envelope(SCAN, SITE, again))]
                took = (time.process_time_ns() - began) / 1e6
                if local == (first.open(Hypotheses).search == SEARCH_LOCAL):
                    fastest[int(local), number] = min(took, fastest[int(local), number])
                request = SearchRequest(
                    timestamp=again.timestamp, frame_id="map", pose=to_pose(truth), least_log_likelihood=-1e6
                )
                request.search = SEARCH_WHOLE if local else SEARCH_LOCAL
                request.covariance.xx = request.covariance.yy = request.covariance.tt = 0.001
                list(core.handle(Envelope(SEARCH, SITE, request)))
    whole, local_ms = (np.median(row[np.isfinite(row)]) for row in fastest)
    return {"whole": float(whole), "local": float(local_ms), "compared": float(np.isfinite(fastest[1]).sum())}


class Timed(ProjectorCore):
    """Adds up the CPU time of its answers, ns, and counts the lists by their search."""

    spent = 0
    lists: Counter[int]

    def handle(self, received: Envelope) -> list[Envelope]:
        began = time.process_time_ns()
        published = [*super().handle(received)]
        if received.channel in (SCAN, SEARCH):
            self.spent += time.process_time_ns() - began
        self.lists.update(one.open(Hypotheses).search for one in published if one.channel is HYPOTHESES)
        return published


def mix(name: str, seconds: float) -> dict[str, dict[str, float]]:
    """Of a log, with and without `local_fits`: CPU ms a scan, share of local fits. The first run warms up."""
    case = next(case for case in CASES if case.folder == name)
    folder = DATASETS / case.folder
    log = read_log(folder / case.log, LogOptions(), lambda _: None)
    built = build(folder / "map.yaml", MapbuilderSettings(), lambda _: None).models
    found = {}
    for local in (False, False, True):
        projector, tracker = Timed(ProjectorSettings()), TrackerCore(TrackerSettings(local_fits=local))
        projector.lists = Counter()
        loop = Loopback([ScanIngestCore(ScanIngestSettings()), projector, tracker])
        for model in built:
            loop.receive(model)
        for received in log.between(Window(int(log.scans[0]), int(log.scans[0] + seconds * 1e9))):
            loop.receive(received)
        scans = max(projector.lists.total(), 1)
        found[f"local_fits = {str(local).lower()}"] = {
            "ms": projector.spent / 1e6 / scans, "local": projector.lists[SEARCH_LOCAL] / scans
        }  # fmt: skip
    return found


def show(found: dict[str, Any]) -> None:
    print(
        f"{found['free_m2']:.0f} m2 free, {found['regions']} regions, {found['spacing_m']} m; "
        f"first right {found['top1']:.1%}, in the list {found['in_list']:.1%}"
    )
    print(f"{'stage':24} {'p50 ms':>8} {'p99 ms':>8} {'at best':>8}")
    for name, spent in found["stages_ms"].items():
        least = f"{spent['least']:8.3f}" if spent["least"] is not None else ""
        print(f"{name:24} {spent['median']:8.3f} {spent['p99']:8.3f} {least}")
    print(f"one core: {found['machine']['gflops']:.0f} Gflop/s, {found['machine']['gbytes']:.1f} GB/s")
    print(
        f"start from the models {found['start_s']:.2f} s, first scan of a lidar {found['first_scan_s']:.3f} s"
    )
    local = dict(found["local_fits"])
    whole, fit = local.pop("whole"), local.pop("local")
    print(
        f"CPU ms a scan: whole {whole:.2f}, local {fit:.2f} ({fit / whole:.0%}), "
        f"of {local.pop('compared'):.0f} scans"
    )
    for setting, row in local.items():
        print(f"{setting}: {row['ms']:.2f} ms a scan, {row['local']:.0%} of the scans fitted locally")
    print("kB/m2: " + ", ".join(f"{name} {kb:.1f}" for name, kb in found["kb_per_m2"].items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--area", type=float, default=700.0)
    parser.add_argument("--spacing", type=float, default=0.5)
    parser.add_argument("--scans", type=int, default=200)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--log", help="folder of a dataset for the mix, such as intel")
    parser.add_argument("--seconds", type=float, default=120.0, help="of that log")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = measure(options)
    show(found)
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
