"""Unexpected obstacles against the simulator's truth: precision and recall of the mask, beam by beam.

    .venv/bin/python benchmarks/obstacles.py [--seconds 60] [--people 6] [--json OUT]

People walk about in the simulated office, and the map that the projector has lacks every third piece of its
furniture. A beam is on an obstacle that ends on a person or on what the map lacks. Beams that end within 8 m
count, of scans whose first pose is right within 0.5 m and 10 degrees.
"""

import argparse
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import from_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.schemas.channels import SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.workbench.evaluation.metrics import errors, right
from eigenscan.workbench.simulation.lidar import Lidar, unexpected
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from single_scan import projector

NEAR = 8.0
LACKING = 3
LIDARS = {
    "180 deg, 0.5 deg, 30 m": Lidar(),
    "270 deg, 1 deg, 20 m, 3 cm": Lidar(beams=271, fov=1.5 * np.pi, range_max=20.0, noise=0.03),
    "360 deg, 1 deg, 12 m": Lidar(beams=360, fov=2 * np.pi * 359 / 360, range_max=12.0),
    "240 deg, 0.36 deg, 5.6 m": Lidar(beams=667, fov=np.deg2rad(239.76), range_max=5.6),
}


def judge(lidar: Lidar, seconds: float, people: int) -> dict[str, Any]:
    """Beams of all scans of a drive that are on obstacles, masked, and both."""
    plan = office()
    lacking = tuple(thing for i, thing in enumerate(plan.furniture) if i % LACKING)
    world, map_ = plan.render(), replace(plan, furniture=lacking).render()
    core = projector(build_site(map_, Plan()))
    stage = Stage(world, Scenario(seconds=seconds, seed=3, people=people, lidar=replace(lidar, rate=2.0)))
    there, known = RayCaster.of(world), RayCaster.of(map_)
    real = masked = both = localized = scans = 0
    for envelope in (t.envelope for t in stage.messages() if t.envelope.channel == SCAN_RAW):
        raw = envelope.open(RawScan)
        time = nanoseconds(raw.timestamp)
        scan = Scan()
        for name in ("timestamp", "mount"):
            getattr(scan, name).CopyFrom(getattr(raw, name))
        scan.angle_min, scan.angle_increment = raw.angle_min, raw.angle_increment
        scan.range_max, scan.ranges[:] = raw.range_max, raw.ranges
        said = list(core.handle(Envelope(SCAN, {"site": "s", "robot": "r", "lidar": "l"}, scan)))
        scans += 1
        first = np.array(from_message(said[0].open(Hypotheses).hypotheses[0].pose))
        truth = stage.pose_at(time)
        if not right(*errors(first[None], truth[None]))[0]:
            continue
        localized += 1
        ranges = np.array(raw.ranges)
        near = np.isfinite(ranges) & (ranges <= NEAR)
        on_it = unexpected(stage.scenario.lidar, there, known, truth, stage.people_at(time)) & near
        mask = (np.frombuffer(said[1].open(Obstacles).mask, dtype=np.uint8) == 0) & near
        real, masked, both = real + on_it.sum(), masked + mask.sum(), both + (on_it & mask).sum()
    return {
        "scans": scans, "localized": localized, "beams": int(real),
        "precision": both / max(masked, 1), "recall": both / max(real, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--people", type=int, default=6)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {name: judge(lidar, options.seconds, options.people) for name, lidar in LIDARS.items()}
    print(f"{'lidar':30} scans localized  beams precision recall")
    for name, row in found.items():
        print(
            f"{name:30} {row['scans']:5d} {row['localized']:9d} {row['beams']:6d} "
            f"{row['precision']:9.1%} {row['recall']:6.1%}"
        )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1, default=float))


if __name__ == "__main__":
    main()
