"""Never sure of a wrong place: what is claimed while sensors, set-up or odometry lie, and what health states.

    .venv/bin/python benchmarks/integrity.py [--only jarvis] [--fault frozen] [--quick]
        [--set tracker.local_fits=false] [--json OUT]

Each fault (benchmarks/integrity_faults.py) is put into windows of real logs, from their start on unless its
name shows otherwise. Counted are scans whose pose is claimed with a confidence above 0.9 and above 0.99
although it is not within 0.5 m and 10 degrees of where the robot was; for an invented room each claim
counts. `named` shows in how many of the windows in which the robot moves the health of scan-ingest or
tracker became DEGRADED, and how many seconds after it had moved by 0.3 m or 0.3 rad; `alarms` of the
unfaulted log are false ones. Faults were chosen and judged while looking at jarvis and intel; fr079, the
guardians and olin are for reporting only.

The datasets are not part of the project; by default they are looked for beside it.
"""

import argparse
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import from_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.projector.core import ProjectorCore
from eigenscan.runtime.choices import Choices
from eigenscan.schemas.channels import POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.workbench.evaluation.chosen import SERVICES, PipelineSettings, chosen
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.metrics import errors, right
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.reference import NS, Trajectory, read_trajectory
from eigenscan.workbench.evaluation.remembering import Remembering
from eigenscan.workbench.evaluation.windows import Window, plan_windows, read_windows, thin
from eigenscan.workbench.logs import LogOptions
from elsewhere import Elsewhere
from evaluate import CASES, DATASETS, Case, wanted
from integrity_faults import BEGINS_S, FAULTS, Stretch, faulty

MOVED_M, MOVED_RAD = 0.3, 0.3
"""A robot that moved by less gives nothing to compare."""
HEALTH_EVERY_NS = NS // 2
QUICK = 4
"""Windows of each log in quick mode."""


@dataclass
class Cell:
    """What one fault did to one log."""

    scans: int = 0
    above_90: int = 0
    above_99: int = 0
    right_claims: int = 0
    windows: int = 0
    moving: int = 0
    named_after_s: list[float] = field(default_factory=list)
    levels_m: list[float] = field(default_factory=list)
    exceeded: int = 0
    published: Counter[str] = field(default_factory=Counter)

    def as_json(self) -> dict[str, Any]:
        named = self.named_after_s
        return {
            "scans": self.scans,
            "wrong_above_0.9": self.above_90,
            "wrong_above_0.99": self.above_99,
            "rightly_claimed": self.right_claims,
            "windows": self.windows,
            "windows_moving": self.moving,
            "windows_named": len(named),
            "named_within_3_s": sum(seconds <= 3.0 for seconds in named),
            "named_after_s": {"median": float(np.median(named)), "max": max(named)} if named else None,
            "protected": len(self.levels_m),
            "level_exceeded": self.exceeded,
            "level_m": {
                "median": float(np.median(self.levels_m)),
                "p95": float(np.percentile(self.levels_m, 95)),
            }
            if self.levels_m
            else None,
            "said": dict(self.published.most_common(3)),
        }


class Site:
    """A log, its reference, and a projector that knows its map."""

    def __init__(self, case: Case, datasets: Path, settings: PipelineSettings) -> None:
        folder = datasets / case.folder
        self.log: Log = read_log(folder / case.log, LogOptions(), lambda _: None)
        self.truth: Trajectory = read_trajectory(folder / case.reference).restamped(self.log.logged)
        listed = folder / "windows.csv"
        self.windows: Sequence[Window] = (
            read_windows(listed, 0.0) if listed.exists() else plan_windows(self.log.scans, self.truth)
        )
        self.models = build(folder / "map.yaml", settings.mapbuilder, lambda _: None).models
        self.settings = settings
        self.elsewhere = Elsewhere.of(case.name, datasets)
        self.searches = Remembering()
        self.projector = ProjectorCore(settings.projector, search=self.searches)
        for model in self.models:
            if model.channel in self.projector.inputs:
                list(self.projector.handle(model))

    def try_fault(self, name: str, limit: int | None) -> Cell:
        cell = Cell()
        self.searches.forget()
        windows = thin(list(self.windows), limit)
        for number, window in enumerate(windows):
            received = [_copy(e) for e in self.log.between(window)]
            self._run(name, faulty(name, received, self.log, windows, number, self.elsewhere), cell)
        return cell

    def _run(self, name: str, stretch: Stretch, cell: Cell) -> None:
        ingest, tracker = ScanIngestCore(self.settings.ingest), TrackerCore(self.settings.tracker)
        for model in self.models:
            if model.channel in tracker.inputs:
                list(tracker.handle(model))
        self.projector.forget_robots()
        loop = Loopback([ingest, self.projector, tracker])
        published, asked, named = list[Envelope](), 0, None
        loop.start()
        moved_at = self._moved_at(stretch, name)
        for envelope in stretch.received:
            published += loop.receive(envelope)
            if envelope.stamp - asked >= HEALTH_EVERY_NS:
                asked = envelope.stamp
                for core in (ingest, tracker):
                    condition = core.condition()
                    if condition.status == Health.STATUS_DEGRADED and named is None:
                        named = envelope.stamp
                        cell.published[_without_numbers(condition.detail)] += 1
        published += loop.finish()
        cell.windows += 1
        cell.moving += moved_at is not None
        if named is not None and (moved_at is not None or name == "none"):
            cell.named_after_s.append(max(named - (moved_at or named), 0) / NS)
        self._judge([e.open(PoseEstimate) for e in published if e.channel is POSE], stretch, cell)

    def _judge(self, poses: list[PoseEstimate], stretch: Stretch, cell: Cell) -> None:
        for pose in poses:
            own = nanoseconds(pose.timestamp)
            at = stretch.truth_at.get(own, own)
            is_right, off = False, np.array([np.inf, np.inf])
            if at is not None:
                truth, known = self.truth.at([at])
                if not known[0]:
                    continue
                off = np.ravel(errors(from_message(pose.pose)[None], truth))
                is_right = bool(right(*off))
            cell.scans += 1
            claimed = pose.state == STATE_LOCALIZED
            cell.right_claims += claimed and is_right
            if pose.HasField("protection_radius"):
                cell.levels_m.append(pose.protection_radius)
                cell.exceeded += bool(off[0] > pose.protection_radius or off[1] > pose.protection_angle)
            cell.above_90 += claimed and not is_right and pose.confidence > 0.9
            cell.above_99 += claimed and not is_right and pose.confidence > 0.99

    def _moved_at(self, stretch: Stretch, name: str) -> int | None:
        """When the robot had moved under the fault, by the reference, ns; None where it hardly did."""
        onset = min(e.stamp for e in stretch.received if e.channel is SCAN_RAW) + round(
            BEGINS_S.get(name, 0.0) * NS
        )
        stamps = np.array([e.stamp for e in stretch.received if e.stamp >= onset])
        poses, known = self.truth.at(stamps)
        poses, stamps = poses[known], stamps[known]
        if not len(poses):
            return None
        far = np.hypot(*(poses - poses[0])[:, :2].T) > MOVED_M
        turn = np.abs((poses[:, 2] - poses[0, 2] + np.pi) % (2 * np.pi) - np.pi) > MOVED_RAD
        moved = np.flatnonzero(far | turn)
        return int(stamps[moved[0]]) if len(moved) else None


def _copy(envelope: Envelope) -> Envelope:
    return Envelope(envelope.channel, envelope.address, envelope.message)


def _without_numbers(detail: str) -> str:
    return "".join("#" if letter.isdigit() else letter for letter in detail)


def show(name: str, fault: str, cell: Cell) -> None:
    after = f"{np.median(cell.named_after_s):6.1f} s" if cell.named_after_s else "       -"
    within = sum(seconds <= 3.0 for seconds in cell.named_after_s)
    published = cell.published.most_common(1)
    print(
        f"{name:<11}{fault:<34}{cell.scans:>7}{cell.above_90:>7}{cell.above_99:>7}{cell.right_claims:>7}"
        f"{len(cell.levels_m):>7}{cell.exceeded:>5}{len(cell.named_after_s):>5} of {cell.moving:<3}"
        f"{within:>4}{after}  {published[0][0] if published else ''}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument("--fault", action="append", help="a part of a fault's name; may be given again")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK} windows of each log")
    parser.add_argument("--set", action="append", default=[], help="SERVICE.SETTING=VALUE, any number")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    settings = chosen(Choices.of("default", None, options.set, SERVICES))
    print(
        f"{'log':<11}{'fault':<34}{'scans':>7}{'> 0.9':>7}{'> 0.99':>7}{'right':>7}{'level':>7}{'over':>5}"
        f"{'named':>11}{'3 s':>4}{'median':>8}  what health says"
    )
    found: dict[str, dict[str, Any]] = {}
    for case in wanted(CASES, options.only):
        site = Site(case, options.datasets, settings)
        for name in FAULTS:
            if options.fault and not any(part in name for part in options.fault):
                continue
            cell = site.try_fault(name, QUICK if options.quick else None)
            show(case.name, name, cell)
            found.setdefault(case.name, {})[name] = cell.as_json()
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
