"""How long a robot waits for its first answer, by area: with tables that are kept, without, for other lidars.

    .venv/bin/python benchmarks/first_scan.py [--areas 800 8311 51960] [--json OUT]

Simulated office floors (benchmarks/floors.py), the mapbuilder's models of them, one projector's core.
A start is a new view of a lidar: the declared one (first, 180 degrees), the same with tables of an earlier
process (kept), one of 360 degrees before the mapbuilder has its eigenspaces (other), and after (added).
Times are of one core, whatever else the machine does. `right`: the share of such first answers whose first
pose is within 0.5 m; `later`: of answers once every table is made.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.table_folder import TableFolder
from eigenscan.projector.warm_up import warm_up
from eigenscan.schemas.channels import HYPOTHESES, LIDAR_KIND, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from floors import floor, poses, scan_at

LIDAR = {"site": "s", "robot": "r", "lidar": "front"}
STARTS, LATER = 10, 10
WIDE = 2 * np.pi


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--areas", type=float, nargs="+", default=[800.0, 8311.0, 51960.0])
    parser.add_argument("--cache", type=Path, help="folder that keeps the floors' models for the next run")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    warm_up(ProjectorSettings())
    rows = []
    for area in given.areas:
        rows.append(measure(area, given.cache))
        if len(rows) == 1:
            print(" ".join(f"{name:>15}" for name in rows[0]))
        print(" ".join(f"{value:15.4g}" for value in rows[-1].values()), flush=True)
    if given.json:
        given.json.write_text(json.dumps({"first_scan": rows}, indent=1) + "\n", encoding="utf-8")


def measure(area: float, cache: Path | None) -> dict[str, float]:
    site = _models(area, cache)
    builder = MapbuilderCore(MapbuilderSettings(), site, "s")
    published = list(builder.start())
    caster, truths = RayCaster.of(site.grid), poses(site.grid, STARTS + LATER, 5)
    narrow, wide = ([scan_at(caster, p, i, view) for i, p in enumerate(truths)] for view in (np.pi, WIDE))
    with tempfile.TemporaryDirectory() as folder:
        core = ProjectorCore(ProjectorSettings(), store=TableFolder(Path(folder)))
        began = time.process_time()
        for envelope in published:
            list(core.handle(envelope))
        row: dict[str, float] = {"m2": site.grid.free_area, "regions": len(site.regions)}
        row["taken_s"] = time.process_time() - began
        row["first_s"], row["right"] = starts(core, narrow, truths)
        began = time.process_time()
        views(core)[-1].tables.work_aside()
        row["rest_s"] = time.process_time() - began
        complete(core)
        row["later_ms"], row["later_right"] = later(core, narrow, truths)
        row["kept_s"], _ = starts(core, narrow, truths)
        row["kept_mb"] = sum(path.stat().st_size for path in Path(folder).rglob("*.npy")) / 1e6
    row["other_s"], row["other_right"] = starts(core, wide, truths)
    asked = next(
        e for e in core.handle(Envelope(SCAN, LIDAR | {"lidar": "w"}, wide[0])) if e.channel is LIDAR_KIND
    )
    began = time.process_time()
    spaces = list(builder.handle(asked))
    row["spaces_s"] = time.process_time() - began
    row["spaces_mb"] = sum(envelope.message.ByteSize() for envelope in spaces) / 1e6
    for envelope in spaces:
        list(core.handle(envelope))
    row["added_s"], row["added_right"] = starts(core, wide, truths)
    return row


def _models(area: float, cache: Path | None) -> SiteModel:
    place = cache / f"floor{area:.0f}" if cache else None
    if place is not None and place.exists():
        return read_models(place)
    built = build_site(floor(area), Plan(threads=2))
    if place is not None:
        write_models(built, place)
    return built


def views(core: ProjectorCore) -> list[Any]:
    assert core._site is not None
    return list(core._site._views.values())


def complete(core: ProjectorCore) -> None:
    for view in views(core):
        view.complete()


def starts(core: ProjectorCore, scans: list[Scan], truths: np.ndarray) -> tuple[float, float]:
    """Median time, s, of the first answers of views that are made again, and the share that is right."""
    assert core._site is not None

    def restart() -> None:
        core._site._views.clear()  # type: ignore[union-attr]
        core._site._sensors.clear()  # type: ignore[union-attr]

    return answers(core, scans[:STARTS], truths[:STARTS], restart)


def later(core: ProjectorCore, scans: list[Scan], truths: np.ndarray) -> tuple[float, float]:
    seconds, right = answers(core, scans[STARTS:], truths[STARTS:], lambda: None)
    return 1e3 * seconds, right


def answers(
    core: ProjectorCore, scans: list[Scan], truths: np.ndarray, before: Callable[[], None]
) -> tuple[float, float]:
    times, right = [], []
    for scan, truth in zip(scans, truths, strict=True):
        before()
        began = time.process_time()
        published = list(core.handle(Envelope(SCAN, LIDAR, scan)))
        times.append(time.process_time() - began)
        message = next(e.message for e in published if e.channel is HYPOTHESES)
        assert isinstance(message, Hypotheses)
        first = message.hypotheses[:1]
        right.append(any(np.hypot(h.pose.x - truth[0], h.pose.y - truth[1]) <= 0.5 for h in first))
    return float(np.median(times)), float(np.mean(right))


if __name__ == "__main__":
    main()
