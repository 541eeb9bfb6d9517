"""Makes the vectors: `python -m eigenscan.workbench.conformance.generation FOLDER`.

They hold a wing of the demo's building, a drive through it, and the answers of our services. The same code on
the same machine makes the same bytes, so a changed vector shows a changed contract, simulator or service.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

from eigenscan.geometry.gridmap import write_map
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, POSE, SCAN, SCAN_RAW, TRACKS, TRUTH
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.conformance.vectors import DRIVE, LIDARS, MAP_FILE
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import Scenario, Stage, Timed
from eigenscan.workbench.simulation.world import FloorPlan, office

ROOMS = ("laboratory", "store", "hallway", "library", "workshop")
SCENARIO = Scenario(seconds=9.0, seed=3, people=1, lidar=Lidar(beams=181, rate=5.0))
PLAN = Plan(step=math.radians(1.0))
LATENCY_NS = 3_000_000
"""Delay of an answer's log time after its input's."""
ODD_SCANS = 12
"""Scans that the oddly mounted lidars take."""
_KEPT = {ODOMETRY, SCAN, HYPOTHESES, POSE, TRACKS, TRUTH}


def wing(plan: FloorPlan) -> FloorPlan:
    """ROOMS of the plan, with the doors between them."""
    rooms = {name: plan.rooms[name] for name in ROOMS}
    doors = tuple(
        door
        for door in plan.doors
        if sum(
            room.x_min <= door.x_max
            and door.x_min <= room.x_max
            and room.y_min <= door.y_max
            and door.y_min <= room.y_max
            for room in rooms.values()
        )
        == 2
    )
    return replace(plan, rooms=rooms, doors=doors)


def generate(folder: Path) -> None:
    """Writes all vectors into `folder`."""
    grid = wing(office()).render()
    write_map(grid, folder / MAP_FILE)
    models = list(MapbuilderCore(MapbuilderSettings(), build_site(grid, PLAN)).start())
    stage = Stage(grid, SCENARIO)
    pipeline: list[Core] = [
        ScanIngestCore(ScanIngestSettings()),
        ProjectorCore(ProjectorSettings(published=10)),
        TrackerCore(TrackerSettings()),
    ]
    logged = list(_answered(stage.messages(), pipeline, models))
    first = logged[0].time
    _write(folder / DRIVE, [*(Timed(first, model) for model in models), *logged])
    raw = [timed for timed in stage.messages() if timed.envelope.channel is SCAN_RAW]
    odd = [timed for one in raw[:ODD_SCANS] for timed in (one, *_odd_lidars(one))]
    ingest = ScanIngestCore(ScanIngestSettings())
    both = [Timed(t.time + n, e) for t in odd for n, e in enumerate([t.envelope, *ingest.handle(t.envelope)])]
    _write(folder / LIDARS, both)


def _answered(
    messages: Iterator[Timed], cores: Sequence[Core], models: Sequence[Envelope]
) -> Iterator[Timed]:
    """The drive and the cores' answers, without channels that no vector needs."""
    loop = Loopback(cores)
    loop.start()
    for model in models:
        loop.receive(model)
    last = 0
    for timed in messages:
        last = timed.time + LATENCY_NS
        for time, envelope in [
            (timed.time, timed.envelope),
            *((last, e) for e in loop.receive(timed.envelope)),
        ]:
            if envelope.channel in _KEPT:
                yield Timed(time, envelope)
    yield from (Timed(last, envelope) for envelope in loop.finish() if envelope.channel in _KEPT)


def _odd_lidars(timed: Timed) -> Iterator[Timed]:
    """The same sweep by lidars that are mounted, limited or driven in another way."""
    raw = timed.envelope.open(RawScan)
    last = raw.angle_min + (len(raw.ranges) - 1) * raw.angle_increment
    ranges = list(raw.ranges)
    clockwise = deepcopy(raw)
    clockwise.angle_min, clockwise.angle_increment = last, -raw.angle_increment
    clockwise.ranges[:] = ranges[::-1]
    upside_down = deepcopy(raw)
    upside_down.mount.CopyFrom(Pose2(x=-0.2, y=0.1, theta=math.pi / 2))
    upside_down.upside_down = True
    limited = deepcopy(raw)
    limited.range_min, limited.range_max = 0.5, 4.0
    # as drivers have it: nothing seen is 0, -1, infinity, or the maximum
    limited.ranges[:] = [(0.0, -1.0, math.inf, 4.0)[n % 4] if n < 20 else r for n, r in enumerate(ranges)]
    limited.angle_min = raw.angle_min + math.tau
    for name, scan in (("clockwise", clockwise), ("upside-down", upside_down), ("limited", limited)):
        yield Timed(timed.time, Envelope(SCAN_RAW, {**timed.envelope.address, "lidar": name}, scan))


def _write(path: Path, messages: Sequence[Timed]) -> None:
    with RecordingWriter(path) as writer:
        for timed in messages:
            writer.write(timed.envelope, timed.time)


if __name__ == "__main__":
    generate(Path(sys.argv[1]))
