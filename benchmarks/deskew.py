"""What deskewing gains: poses of a robot that turns while its lidar sweeps, and scans of real lidars.

    .venv/bin/python benchmarks/deskew.py [--only jarvis] [--seconds 60] [--json OUT]

Simulated robots drive in the demo's building; their lidars sweep, state the time between beams or do not, and
state the beams in their order or against it. A row: claimed poses that turn faster than 0.3 rad/s, how far
they are off (median and 95th percentile), and the order that was found. Then logs of real lidars that state
that time, each on its own map: the order, after how many seconds it was found; and of the scans that turn
faster than 0.15 rad/s, by how many nats the best pose is likelier (median), and of how many it is.
"""

import argparse
import json
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.gridmap import write_map
from eigenscan.geometry.pose import between, from_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.deskew import Deskew
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.channels import POSE, SCAN, SCAN_RAW, TRUTH
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.pipeline import Packed, pack, unpack
from eigenscan.workbench.simulation.lidar import LIDARS
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from evaluate import DATASETS, wanted
from maps import LOGS, Case, read_case
from range_errors import site_of

SWEEPING = ("rplidar-a1", "rplidar-a2", "sick-tim571")
WAYS = {"not stated": 0.0, "in order": 1.0, "reversed": -1.0}
"""By what the stated time between beams is multiplied."""
TURNING, SLOWLY = 0.3, 0.15
"""rad/s"""
HALF_NS = 50_000_000
"""Half of the time over which the true turn is taken."""
SEEDS = (1, 2, 3)
EVERY = 3
"""Of a log's scans that turn, every third is looked up."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each simulated drive")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    simulated, logs = list(simulate(options.seconds)), list[dict[str, Any]]()
    print(f"\n{'log':<12}{'lidar':<26}{'order':>6}{'after s':>9}{'turning':>9}{'nats':>7}{'likelier':>10}")
    for listed in wanted(LOGS, options.only):
        case = read_case(listed.name, options.datasets / listed.folder, listed.log, listed.reference)
        if any(e.channel is SCAN_RAW and e.open(RawScan).time_increment for e in case.log.whole[:200]):
            for row in looked_up(case):
                logs.append(row)
                after = "-" if row["after_s"] is None else f"{row['after_s']:.1f}"
                gain = f"{row['nats']:>7.2f}{row['likelier']:>10.0%}" if row["scans"] else ""
                print(
                    f"{row['log']:<12}{row['lidar']:<26}{row['order']!s:>6}{after:>9}{row['scans']:>9}{gain}",
                    flush=True,
                )
    if options.json:
        text = json.dumps({"simulated": simulated, "logs": logs}, indent=1)
        options.json.write_text(text + "\n", encoding="utf-8")


def simulate(seconds: float) -> Iterator[dict[str, Any]]:
    """Rows of simulated robots."""
    grid = office().render()
    with tempfile.TemporaryDirectory() as folder:
        write_map(grid, Path(folder) / "map.yaml")
        models = pack(build(Path(folder) / "map.yaml", MapbuilderSettings(), lambda _: None).models)
    print(f"{'lidar':<13}{'beams':<12}{'turning':>8}{'cm':>6}{'95 %':>6}{'deg':>7}{'95 %':>7}  orders")
    for name in SWEEPING:
        stages = [Stage(grid, Scenario(seconds=seconds, seed=seed, lidar=LIDARS[name])) for seed in SEEDS]
        for way, times in WAYS.items():
            row = judged(models, stages, times)
            yield {"lidar": name, "stated": way, **row}
            print(
                f"{name:<13}{way:<12}{row['scans']:>8}{row['cm']:>6.1f}{row['cm_p95']:>6.1f}"
                f"{row['deg']:>7.2f}{row['deg_p95']:>7.2f}  {row['orders']}",
                flush=True,
            )


def judged(models: Packed, stages: list[Stage], times: float) -> dict[str, Any]:
    """How far claimed poses are off while the robots turn."""
    errors, orders = list[Any](), list[int | None]()
    for stage in stages:
        ingest, published = ScanIngestCore(ScanIngestSettings()), list[Envelope]()
        loop = Loopback([ingest, ProjectorCore(ProjectorSettings()), TrackerCore(TrackerSettings())])
        loop.start()
        for envelope in unpack(models):
            loop.receive(envelope)
        for timed in stage.messages():
            if timed.envelope.channel is SCAN_RAW:
                timed.envelope.open(RawScan).time_increment *= times
            if timed.envelope.channel is not TRUTH:
                published += loop.receive(timed.envelope)
        orders += [deskew.order for deskew in deskews(ingest).values()]
        for pose in (e.open(PoseEstimate) for e in published if e.channel is POSE):
            at = nanoseconds(pose.timestamp)
            turned = between(stage.pose_at(at - HALF_NS), stage.pose_at(at + HALF_NS))[2]
            if pose.state == STATE_LOCALIZED and abs(turned) > 2e-9 * HALF_NS * TURNING:
                errors.append(between(stage.pose_at(at), from_message(pose.pose)))
    off = np.array(errors)
    cm, deg = 100.0 * np.hypot(off[:, 0], off[:, 1]), np.degrees(np.abs(off[:, 2]))
    return {
        "scans": len(off),
        "cm": float(np.median(cm)),
        "cm_p95": float(np.quantile(cm, 0.95)),
        "deg": float(np.median(deg)),
        "deg_p95": float(np.quantile(deg, 0.95)),
        "orders": orders,
    }


def deskews(ingest: ScanIngestCore) -> dict[str, Deskew]:
    """By lidar."""
    return {lidar: state.deskew for (_, lidar), state in ingest._lidars.items()}


def looked_up(case: Case) -> Iterator[dict[str, Any]]:
    """A row for each lidar of a log that sweeps."""
    site, settings = site_of(case, "exact"), ProjectorSettings()
    ingest, plain = ScanIngestCore(ScanIngestSettings()), ScanIngestCore(ScanIngestSettings())
    after, gained = dict[str, float](), defaultdict[str, list[float]](list)
    scans = [e for e in case.log.whole if e.channel is SCAN_RAW]
    for number, received in enumerate(scans):
        lidar, raw = received.address["lidar"], RawScan()
        raw.CopyFrom(received.open(RawScan))
        raw.time_increment = 0.0
        pair = list(ingest.handle(received)), list(plain.handle(Envelope(SCAN_RAW, received.address, raw)))
        own = deskews(ingest)[lidar]
        if own.order is not None:
            after.setdefault(lidar, (received.stamp - scans[0].stamp) * 1e-9)
        turning = own.velocity is not None and abs(own.velocity[2]) > SLOWLY
        if own.order and turning and number % EVERY == 0:
            best = [
                _best(scan.open(Scan), site, settings) for e in pair for scan in e if scan.channel is SCAN
            ]
            if len(best) == 2:
                gained[lidar].append(best[0] - best[1])
    for lidar, own in deskews(ingest).items():
        nats = np.array(gained[lidar])
        yield {
            "log": case.name,
            "lidar": lidar,
            "order": own.order,
            "after_s": after.get(lidar),
            "scans": len(nats),
            "nats": float(np.median(nats)) if len(nats) else None,
            "likelier": float((nats > 0.0).mean()) if len(nats) else None,
        }


def _best(scan: Scan, site: Site, settings: ProjectorSettings) -> float:
    seen = observe(scan)
    found = find_candidates(site, site.view(seen.sensor), seen, settings).log_likelihoods
    return float(found.max()) if len(found) else 0.0


if __name__ == "__main__":
    main()
