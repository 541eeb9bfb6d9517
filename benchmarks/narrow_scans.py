"""Narrow and short scans, such as depth cameras give: what is found, and what is claimed falsely.

    .venv/bin/python benchmarks/narrow_scans.py [--datasets FOLDER] [--only jarvis] [--windows 6]
        [--scans 60] [--json OUT]

A log's scans are cut to what other sensors would have seen: one or several sectors, each with a field of view
and a reach. `two lidars` publishes both sectors under a name each, `fused` as one scan; `gathered over 3 m`
is what the bridge makes of them with `gather = 3`.
A window succeeds as in maps.py. The datasets are not part of the project.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.ros_bridge.gathering import Gathering
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.log import Log, Received, read_log
from eigenscan.workbench.evaluation.metrics import errors, judge, right
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.reference import read_trajectory
from eigenscan.workbench.evaluation.windows import plan_scans, plan_windows, thin
from eigenscan.workbench.evaluation.workers import Workers
from eigenscan.workbench.logs import LogOptions
from evaluate import CASES, DATASETS, wanted
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from maps import LAST_SHARE


@dataclass(frozen=True)
class Eyes:
    """Sectors by the bearing of their middle, degrees, all with one field of view, degrees, and reach, m."""

    name: str
    bearings: tuple[float, ...]
    field_of_view: float
    reach: float
    fused: bool = False
    gather: float = 0.0

    def see(self, raw: RawScan) -> Iterator[tuple[str, RawScan]]:
        """What they see of a scan, each sector under its own name, or all under one."""
        ranges = np.array(raw.ranges, dtype=np.float32)
        bearing = np.degrees(raw.mount.theta + raw.angle_min + raw.angle_increment * np.arange(len(ranges)))
        off = [(bearing - middle + 180.0) % 360.0 - 180.0 for middle in self.bearings]
        inside = np.abs(np.array(off)) <= 0.5 * self.field_of_view
        for name, seen in [("fused", inside.any(axis=0))] if self.fused else enumerate(inside):
            cut = RawScan()
            cut.CopyFrom(raw)
            cut.range_max = self.reach
            cut.ranges[:] = np.where(seen, np.where(ranges < self.reach, ranges, np.inf), np.nan).tolist()
            yield f"eye{name}", cut


EYES = (
    Eyes("360°, as it is", (0.0,), 360.0, 1e3),
    Eyes("240°, 5.6 m", (0.0,), 240.0, 5.6),
    Eyes("90°, 8 m", (0.0,), 90.0, 8.0),
    Eyes("60°, 4 m", (0.0,), 60.0, 4.0),
    Eyes("90°, 8 m, gathered over 1 m", (0.0,), 90.0, 8.0, gather=1.0),
    Eyes("90°, 8 m, gathered over 3 m", (0.0,), 90.0, 8.0, gather=3.0),
    Eyes("60°, 4 m, gathered over 3 m", (0.0,), 60.0, 4.0, gather=3.0),
    Eyes("60°, 4 m, ahead and behind: two lidars", (0.0, 180.0), 60.0, 4.0),
    Eyes("60°, 4 m, ahead and behind: fused", (0.0, 180.0), 60.0, 4.0, fused=True),
)


def cut(log: Log, eyes: Eyes) -> Log:
    """The log as the eyes would have recorded it."""
    received = []
    gathering = Gathering(eyes.gather) if eyes.gather else None
    for envelope in log.whole:
        if envelope.channel is ODOMETRY and gathering is not None:
            gathering.receive_odometry(envelope.open(Odometry))
        if envelope.channel is not SCAN_RAW:
            received.append(Received(envelope.stamp, envelope))
            continue
        for name, own in eyes.see(envelope.open(RawScan)):
            raw = gathering.gather(own) if gathering is not None else own
            if raw is None:
                continue
            address = {**envelope.address, "lidar": name}
            received.append(Received(envelope.stamp, Envelope(SCAN_RAW, address, raw)))
    return Log(received, log.logged)


def main() -> None:
    """Prints a line for each log and eyes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", action="append", help="name of a log; default: jarvis")
    parser.add_argument("--windows", type=int, default=6)
    parser.add_argument("--scans", type=int, default=60)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for case in wanted(CASES, options.only or ["jarvis"]):
        folder = options.datasets / case.folder
        log = read_log(folder / case.log, LogOptions(), lambda _: None)
        models = build(folder / "map.yaml", MapbuilderSettings(), lambda _: None).models
        for eyes in EYES:
            rows.append(
                {
                    "log": case.name,
                    "eyes": eyes.name,
                    **_judge(folder / case.reference, log, eyes, models, options),
                }
            )
            print(rows[-1], flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _judge(
    reference_file: Path, whole: Log, eyes: Eyes, models: Any, options: argparse.Namespace
) -> dict[str, Any]:
    reference = read_trajectory(reference_file).restamped(whole.logged)
    log = cut(whole, eyes)
    windows = thin(plan_windows(whole.scans, reference), options.windows)
    stamps = thin(plan_scans(whole.scans, reference), options.scans)
    with Workers(1, models, log.beginning) as workers:
        judged = [judge(run.stream, reference) for run in workers.runs(log.between(each) for each in windows)]
        scans = [scan for stamp in stamps if (scan := log.nearest_scan(stamp, 1.0)) is not None]
        answers = list(workers.answers(scan.envelope for scan in scans))
    truths, known = reference.at([scan.stamp for scan in scans])
    hits = [
        right(*errors(answer.poses, np.broadcast_to(truth, answer.poses.shape)))
        for answer, truth, there in zip(answers, truths, known, strict=True)
        if there
    ]
    claims = sum(int(each.stream.localized.sum()) for each in judged)
    false = [int(each.false_claims.sum()) for each in judged]
    lasting = [
        each.converged is not None and each.converged <= (1.0 - LAST_SHARE) * len(each.stream)
        for each in judged
    ]
    return {
        "windows": len(judged),
        "success": float(np.mean(lasting)),
        "windows_with_a_false_claim": float(np.mean([count > 0 for count in false])),
        "claims_false": sum(false) / max(claims, 1),
        "claimed": claims / max(sum(len(each.stream) for each in judged), 1),
        "one_scan_first": float(np.mean([hit[:1].any() for hit in hits])),
        "one_scan_in_list": float(np.mean([hit.any() for hit in hits])),
    }


if __name__ == "__main__":
    main()
