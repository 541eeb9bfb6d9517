"""Keeping the map true: passes until a moved cupboard is in the models, and what people and wrong robots do.

    .venv/bin/python benchmarks/keeping.py [--hours 10] [--json OUT]

The real cores in the simulated office, each pass from a cold start, half an hour after the one
before. `in room`, of the scans in the room whose cupboard moved: the share of right claims (localized, within
0.5 m), that of wrong ones, and the error of the right ones, m, median and 95th percentile.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.folder import write_models
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.pose import from_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.keeping.custodian import Custodian
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.loopback import Loopback
from eigenscan.schemas.channels import HYPOTHESES, POSE, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.tick import tick
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import EPOCH_NS, Scenario, Stage
from eigenscan.workbench.simulation.world import CUPBOARD, Box, office

VISIT_S = 1800.0
MOVES = {"to the opposite wall": (-4.85, -1.2), "along its wall": (0.0, -1.9), "into the room": (-1.2, 0.0)}
"""m; the first makes the bureau look as if it was shifted by the cupboard's depth."""
RIGHT_M = 0.5
BUREAU = Box(4.0, 7.5, 9.5, 12.0)
TOUR = ((5.2, 6.5), (5.2, 8.2), (8.3, 10.4), (6.6, 10.2), (5.2, 8.2), (5.2, 6.5), (12.0, 6.5))
"""From the hallway once around the bureau and out again."""
TOUR_S = 75.0
PASSES = 10
START = (1.5, 6.5)
LIDAR = Lidar(beams=181, rate=5.0)

Falsify = Callable[[PoseEstimate], None]


@dataclass
class Pass:
    """What was said of one robot's drive."""

    scans: int = 0
    answers: int = 0
    in_room: int = 0  # poses in the bureau, claimed or not
    errors: list[float] = field(default_factory=list)  # m, of those that were claimed
    versions: list[str] = field(default_factory=list)  # of each pose, in order


class Site:
    """Projector and mapbuilder over one model folder, and robots that drive by."""

    def __init__(self, known: GridMap, folder: Path, changes: str = "publish") -> None:
        self.folder, self.changes = folder, changes
        write_models(build_site(known, Plan()), folder)
        self.projector = ProjectorCore(ProjectorSettings())
        self.start_mapbuilder()

    def start_mapbuilder(self) -> None:
        """A new mapbuilder on the folder; the one before is gone without a word."""
        settings = MapbuilderSettings(changes=self.changes, visit=VISIT_S / 60)
        self.mapbuilder = Custodian(Store(self.folder), settings)
        self._teach(self.mapbuilder.start())

    @property
    def version(self) -> str:
        """Of the models in use, as the mapbuilder tells it."""
        return self.mapbuilder.condition().detail.partition("version ")[2][:12]

    @property
    def counters(self) -> dict[str, int]:
        return dict(self.mapbuilder.condition().counters)

    def pulse(self) -> None:
        """A second has passed: what came into use is published."""
        self._teach(self.mapbuilder.handle(tick(0)))

    def _teach(self, said: Iterator[Envelope]) -> None:
        for envelope in said:
            list(self.projector.handle(envelope))

    def drive(
        self,
        real: GridMap,
        scenario: Scenario,
        at_s: float,
        falsify: Falsify | None = None,
        robot: str = "r1",
    ) -> Pass:
        """One robot's drive, from a cold start, `at_s` after the beginning; `falsify` may change poses."""
        stage = Stage(real, scenario)
        stage.epoch = EPOCH_NS + round(at_s * 1e9)
        loop = Loopback(
            [ScanIngestCore(ScanIngestSettings()), self.projector, TrackerCore(TrackerSettings())]
        )
        loop.start()
        done = Pass()
        for timed in stage.messages():
            for envelope in loop.hear(timed.envelope):
                self._note(done, stage, envelope)
                if envelope.channel in (SCAN, POSE):
                    if envelope.channel is POSE and falsify:
                        falsify(envelope.open(PoseEstimate))
                    heard = Envelope(envelope.channel, {**envelope.address, "robot": robot}, envelope.message)
                    self._teach(self.mapbuilder.handle(heard))
            if timed.envelope.channel is SCAN_RAW:
                done.scans += 1
                self.pulse()
        return done

    @staticmethod
    def _note(done: Pass, stage: Stage, envelope: Envelope) -> None:
        done.answers += envelope.channel is HYPOTHESES
        if envelope.channel is POSE:
            pose = envelope.open(PoseEstimate)
            done.versions.append(pose.model_version)
            truth = stage.pose_at(nanoseconds(pose.timestamp))
            inside = bool(BUREAU.covers(truth[:1], truth[1:2])[0])
            done.in_room += inside
            if inside and pose.state == STATE_LOCALIZED:
                done.errors.append(float(np.hypot(*(from_message(pose.pose) - truth)[:2])))


def tour(seed: int, people: int = 2) -> Scenario:
    """One pass: in and out of the bureau."""
    return Scenario(seconds=TOUR_S, seed=seed, people=people, lidar=LIDAR, start=START, goals=TOUR)


def moved_cupboard(folder: Path, move: tuple[float, float]) -> dict[str, Any]:
    """Passes until the cupboard is in the models at its new place, and the robot's luck in its room."""
    plan = office()
    known, real = plan.render(), plan.with_moved(CUPBOARD, *move).render()
    site = Site(known, folder)
    before = site.drive(known, tour(1), 0.0)
    passes: list[Pass] = []
    published: list[int] = []
    while len(passes) < PASSES:
        version = site.version
        passes.append(site.drive(real, tour(2 + len(passes)), (1 + len(passes)) * VISIT_S))
        if site.version != version:
            published.append(len(passes))
    return {
        "published in pass": published,
        "in room, before": _luck([before]),
        "in room, moved": _luck(passes[: (published or [PASSES])[0] - 1]),
        "in room, at last": _luck(passes[-3:]),
        "versions": 1 + len(published),
        "versions said with poses": len({v for p in (before, *passes) for v in p.versions} - {""}),
        "scans unanswered": sum(p.scans - p.answers for p in (before, *passes)),
    }


def _luck(passes: Sequence[Pass]) -> list[float]:
    errors, count = np.array([e for p in passes for e in p.errors]), sum(p.in_room for p in passes)
    right = errors[errors <= RIGHT_M]
    shares = [len(right) / count, (len(errors) - len(right)) / count]
    return [round(float(v), 3) for v in (*shares, *np.percentile(right, (50, 95)))]


def standing_person(folder: Path) -> dict[str, Any]:
    """Someone stands in the bureau for an hour, and a robot comes by every ten minutes."""
    known = office().render()
    site = Site(known, folder)
    for k in range(14):
        scenario = Scenario(**{**vars(tour(k)), "standing": ((7.2, 10.4),) if 3 <= k < 9 else ()})
        site.drive(known, scenario, k * 600.0)
    return {"changes": site.counters.get("changes_published", 0), "visits": site.counters.get("visits", 0)}


def walking_people(folder: Path, hours: float) -> dict[str, Any]:
    """A robot that drives about among six people all day."""
    known = office().render()
    site = Site(known, folder)
    lidar = Lidar(beams=181, rate=2.0)
    for k in range(round(2 * hours)):
        site.drive(known, Scenario(seconds=VISIT_S - 10, seed=k, people=6, lidar=lidar), k * VISIT_S)
    counters = site.counters
    return {
        "hours": hours,
        "changes": counters.get("changes_published", 0),
        "looks": counters["looks_counted"],
    }


def wrong_robot(folder: Path) -> dict[str, Any]:
    """A robot that claims with confidence to be where it is not: 0.5 m and 20 degrees off, or 5 m off."""
    known = office().render()
    site = Site(known, folder)

    def off(pose: PoseEstimate) -> None:
        pose.pose.x += 0.4
        pose.pose.y -= 0.3
        pose.pose.theta += np.deg2rad(20.0)

    def elsewhere(pose: PoseEstimate) -> None:
        pose.pose.y -= 5.0

    for k in range(12):
        site.drive(known, tour(k), k * VISIT_S, falsify=(off, elsewhere)[k % 2])
    counters = site.counters
    return {
        "changes": counters.get("changes_published", 0),
        "looks_counted": counters.get("looks_counted", 0),
        "looks_disagreeing": counters.get("looks_disagreeing", 0),
        "looks_withdrawn": counters.get("looks_withdrawn", 0),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, default=10.0, help="of people who walk about")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    work: dict[str, Callable[[Path], dict[str, Any]]] = {
        f"cupboard moved {how}": partial(moved_cupboard, move=move) for how, move in MOVES.items()
    }
    work |= {"person standing for an hour": standing_person, "robot that claims wrong poses": wrong_robot}
    work["people walking"] = partial(walking_people, hours=options.hours)
    results: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (what, run) in enumerate(work.items()):
            results[what] = run(Path(folder) / str(number))
            print(what)
            for figure, value in results[what].items():
                print(f"  {figure:<25} {value}", flush=True)
    if options.json:
        options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
