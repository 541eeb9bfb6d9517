"""What a scan costs, and how often it finds its place, on floors of growing size.

    .venv/bin/python benchmarks/scale.py [--areas 500 2000 8000 20000 50000] [--scans 100] [--json OUT]

Made-up office floors without two equal rooms, a lidar in steps of half a degree, 10 % of its beams on people.
Each scan is timed three times and its fastest counts; `focused` is with --focus, where the tracker is sure of
the pose. `growth` is the exponent of p50 against the area, from
one row to the next: 1 would be a cost in proportion to the area. Set OMP_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up
from eigenscan.schemas.channels import POSE, Channel
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.wire import decode, encode
from floors import floor, poses, scan_at
from projector import SITE, Stopwatch, is_right, memory, models, one_scan

REPEAT, FOCUSED = 3, 30
SECOND = 1_000_000_000
Heard = tuple[Channel, Mapping[str, str], bytes]


def measure(area: float, options: argparse.Namespace, watch: Stopwatch) -> dict[str, Any]:
    grid = floor(area)
    began = time.perf_counter()
    built = build_site(grid, Plan(spacing=options.spacing))
    build_s = time.perf_counter() - began
    heard = [(e.channel, e.address, encode(e.message)) for e in models(built)]
    began = time.perf_counter()
    core = started(heard, ProjectorSettings())
    start_s = time.perf_counter() - began
    caster, truths = RayCaster.of(grid), poses(grid, options.scans, 3)
    payloads = [
        encode(scan_at(caster, pose, number, np.deg2rad(options.fov))) for number, pose in enumerate(truths)
    ]
    one_scan(core, payloads[0], watch)
    first_scan_s = watch.spent["whole"] / 1e3
    spent, right = [], []
    for payload, truth in zip(payloads, truths, strict=True):
        took = []
        for _ in range(REPEAT):
            message = one_scan(core, payload, watch)
            took.append(dict(watch.spent))
        spent.append(min(took, key=lambda each: each["whole"]))
        right.append(is_right(message, truth))
    whole = np.array([each["whole"] for each in spent])
    focused = focused_ms(heard, caster, truths[:FOCUSED], watch, options.fov)
    return {
        "free_m2": grid.free_area, "regions": len(built.regions),
        "p50_ms": float(np.median(whole)), "p99_ms": float(np.percentile(whole, 99)),
        "project_ms": float(np.median([each["project"] for each in spent])),
        "associate_ms": float(np.median([each["associate"] for each in spent])),
        "focused_p50_ms": float(np.median(focused)),
        "first_right": float(np.mean([hits[:1] == [True] for hits in right])),
        "in_list": float(np.mean([any(hits) for hits in right])),
        "kb_per_m2": memory(core, built)["sum"], "build_s": build_s,
        "start_s": start_s, "first_scan_s": first_scan_s,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3,
    }  # fmt: skip


def focused_ms(
    heard: list[Heard], caster: RayCaster, truths: np.ndarray, watch: Stopwatch, fov: float
) -> list[float]:
    """A scan's cost in a projector with `focus`, that has just heard where the robot is."""
    core = started(heard, ProjectorSettings(focus=True))
    spent = []
    for number, truth in enumerate(truths):
        scan = scan_at(caster, truth, number, np.deg2rad(fov))
        at = (number + 1) * 10 * SECOND
        scan.timestamp.CopyFrom(stamp(at))
        one_scan(core, encode(scan), watch)
        sure = PoseEstimate(timestamp=stamp(at), frame_id="map", state=STATE_LOCALIZED)
        sure.pose.x, sure.pose.y, sure.pose.theta = truth
        core.handle(Envelope(POSE, SITE, sure))
        scan.timestamp.CopyFrom(stamp(at + SECOND // 2))
        took = []
        for _ in range(REPEAT):
            one_scan(core, encode(scan), watch)
            took.append(watch.spent["whole"])
        spent.append(min(took))
    return spent


def started(heard: list[Heard], settings: ProjectorSettings) -> ProjectorCore:
    core = ProjectorCore(settings)
    for channel, address, payload in heard:
        core.handle(Envelope(channel, address, decode(channel, payload)))
    return core


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--areas", type=float, nargs="+", default=[500, 2000, 8000, 20000, 50000])
    parser.add_argument("--spacing", type=float, default=0.5)
    parser.add_argument("--fov", type=float, default=270.0, help="field of view, degrees")
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    warm_up(ProjectorSettings())
    watch, rows = Stopwatch(), list[dict[str, Any]]()
    for area in options.areas:
        row = measure(area, options, watch)
        if rows:
            larger = np.log(row["free_m2"] / rows[-1]["free_m2"])
            row["growth"] = float(np.log(row["p50_ms"] / rows[-1]["p50_ms"]) / larger)
        if not rows:
            print(" | ".join([*row, "growth"]))
        rows.append(row)
        print(" | ".join(f"{v:.3g}" if v < 1000 else f"{v:.0f}" for v in row.values()), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
