"""How soon it shows that ranges or angles are wrong, and whether it seems so where they are right.

    .venv/bin/python benchmarks/range_errors.py [--only jarvis] [--way exact] [--metres 200] [--json OUT]

The first metres of each log are played on maps that are right and worse (benchmarks/worse_maps.py), its
scans as they are and with errors. Whole searches only, by the reference's motion. A row: share of scans that
fit as they are; of the others, nats (median) for the error that fits best; after how many metres an error was
named, and which; `-`: none. The constants were chosen on these logs, with their maps and five worse ones.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import between
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.range_check import Wrong, check, turn_of
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.channels import SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import RangeCheck
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.tracker.range_errors import RangeErrors, gains
from eigenscan.tracker.settings import TrackerSettings
from evaluate import DATASETS, wanted
from integrity_faults import put
from maps import LOGS, Case, read_case, worsened
from numpy.typing import NDArray
from worse_maps import WAYS

Array = NDArray[np.float64]

ERRORS = {
    "none": Wrong(),
    "10 % short": Wrong(0.9),
    "10 % long": Wrong(1.1),
    "25 % long": Wrong(1.25),
    "30 % short": Wrong(0.7),
    "half": Wrong(0.5),
    "twice": Wrong(2.0),
    "0.3 m short": Wrong(offset=-0.3),
    "0.3 m long": Wrong(offset=0.3),
    "beams 10 % wide": Wrong(apart=1.1),
    "beams 10 % near": Wrong(apart=0.9),
    "beams 5 % wide": Wrong(apart=1.05),
    "beams 5 % near": Wrong(apart=0.95),
}
SEED = 7


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument("--way", action="append", choices=list(WAYS), help="default: exact")
    parser.add_argument("--error", action="append", choices=list(ERRORS), help="default: all")
    parser.add_argument("--metres", type=float, default=200.0)
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    rows = list[dict[str, Any]]()
    print(f"{'log':<12}{'map':<28}{'error':<17}{'scans':>6}{'fit':>6}{'nats':>7}{'named after':>13}  as")
    for listed in wanted(LOGS, options.only):
        case = read_case(listed.name, options.datasets / listed.folder, listed.log, listed.reference)
        for way in options.way or ["exact"]:
            site = site_of(case, way)
            for error in options.error or ERRORS:
                rows.append(_judge(case, way, site, error, options.metres))
                print(_line(rows[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def site_of(case: Case, way: str) -> Site:
    """What the projector searches on a log's map, made worse in this way. Exits if it refuses the model."""
    worse, _ = worsened(case, way, SEED)
    core = ProjectorCore(ProjectorSettings())
    for model in MapbuilderCore(MapbuilderSettings(), build_site(worse.grid, Plan())).start():
        if model.channel in core.inputs:
            list(core.handle(model))
    if core._site is None:
        sys.exit(f"{case.name}, {way}: the projector refuses the model")
    return core._site


def _judge(case: Case, way: str, site: Site, error: str, metres: float) -> dict[str, Any]:
    ranges, driven, fit, named = RangeErrors(), 0.0, 0, None
    nats = list[float]()
    scans = 0
    for found, way_m, new in _checks(case, site, ERRORS[error], metres):
        driven += way_m
        ranges.move(new)
        scans += 1
        if found is not None:
            by_error = gains(found)
            ranges.take("lidar", by_error)
            fit += not by_error
            if by_error:
                nats.append(max(by_error.values()))
        if named is None and ranges.fault:
            named = driven, ranges.fault
    return {
        "log": case.name,
        "map": way,
        "error": error,
        "scans": scans,
        "fit": fit / max(scans, 1),
        "nats": float(np.median(nats)) if nats else None,
        "named_after_m": named and named[0],
        "named": named and named[1],
        "driven_m": driven,
    }


def _checks(
    case: Case, site: Site, wrong: Wrong, metres: float
) -> Iterator[tuple[RangeCheck | None, float, float]]:
    """What is found of a scan, and how far, m and in new scans, the robot has come since the last."""
    ingest, settings, tracker = ScanIngestCore(ScanIngestSettings()), ProjectorSettings(), TrackerSettings()
    before, driven = None, 0.0
    for received in case.log.whole:
        if received.channel is not SCAN_RAW or driven > metres:
            continue
        (pose,), (known,) = case.reference.at([received.stamp])
        if not known:
            continue
        step = np.zeros(3) if before is None else between(before, pose)
        way, turn = float(np.hypot(*step[:2])), float(abs(step[2]))
        new = way / tracker.independence_m + turn / tracker.independence_rad
        if before is not None and new < 0.1:  # it stands
            continue
        before, driven = pose, driven + way
        raw = RawScan()
        raw.CopyFrom(received.open(RawScan))
        put(raw, wrong.factor * np.asarray(raw.ranges) + wrong.offset)
        raw.angle_min *= wrong.apart
        raw.angle_increment *= wrong.apart
        for scan in ingest.handle(Envelope(SCAN_RAW, received.address, raw)):
            if scan.channel is SCAN:
                seen = observe(scan.open(Scan))
                view = site.view(seen.sensor)
                search = partial(find_candidates, site, view, settings=settings)
                yield check(site, seen, search(seen), search, turn_of(received.stamp)), way, new


def _line(row: dict[str, Any]) -> str:
    nats = "-" if row["nats"] is None else f"{row['nats']:.1f}"
    after = "-" if row["named"] is None else f"{row['named_after_m']:.1f} m"
    return (
        f"{row['log']:<12}{row['map']:<28}{row['error']:<17}{row['scans']:>6}{row['fit']:>6.0%}{nats:>7}"
        f"{after:>13}  {(row['named'] or '').partition(':')[0]}"
    )


if __name__ == "__main__":
    main()
