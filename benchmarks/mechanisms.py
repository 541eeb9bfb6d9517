"""What each mechanism of the tracker contributes: the same recorded hypotheses, with it and without it.

    .venv/bin/python benchmarks/mechanisms.py --keep FOLDER [--only intel] [--way exact]
        [--fault "an invented room"] [--without "aliases"] [--windows 8] [--seed 1] [--json OUT]

A story is a log on its map, on one that is wrong in some way (worse_maps.py), or with a fault of the sensors
(integrity_faults.py). What the tracker receives is recorded once and kept in FOLDER. Then the tracker runs
over it as it is, and without one mechanism after another. A row holds the windows that succeed (right claims
over the last third), the windows with a false claim, the share of claims that are false, and the scans
claimed wrongly above 0.9 and 0.99. The datasets are not part of the project; by default they are looked for
beside it; `--buildings` takes logs of your own instead, laid out as for evaluate.py; whoever is carried off
one of these maps then goes on in the next building, in alphabetical order. Keep FOLDER to yourself:
its files are pickles, which run code when they are read.
"""

import argparse
import gzip
import json
import pickle
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from eigenscan.geometry.gridmap import write_map
from eigenscan.geometry.pose import from_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker import (
    agreement,
    belief,
    branching,
    claim,
    evidence,
    floors,
    observation,
    robot,
    unification,
)
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.evaluation.metrics import LAST_SHARE, errors, right, sustained
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.pipeline import Packed, pack, unpack
from eigenscan.workbench.evaluation.windows import thin
from elsewhere import Elsewhere
from evaluate import DATASETS, buildings, wanted
from evaluate import Case as Listed
from integrity_faults import FAULTS, faulty
from maps import LOGS, read_case, windows_of, worsened
from worse_maps import WAYS


@dataclass(frozen=True)
class Window:
    """What the tracker receives, and by stamp, ns, the true pose (x, y, theta); None: no pose is right."""

    received: Packed
    truth: Mapping[int, tuple[float, float, float] | None]


@dataclass(frozen=True)
class Story:
    """One log on one map with one fault, or none."""

    models: Packed
    windows: Sequence[Window]


class Tap:
    """Stands where the tracker stands, and keeps what comes."""

    inputs, outputs = TrackerCore.inputs, TrackerCore.outputs

    def __init__(self) -> None:
        self.received: list[Envelope] = []

    def start(self) -> Iterable[Envelope]:
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        self.received.append(received)
        return ()

    def finish(self) -> Iterable[Envelope]:
        return ()

    def condition(self) -> Condition:
        return Condition(Health.STATUS_OK, "", {})


def record(
    listed: Listed, way: str, fault: str, datasets: Path, others: Elsewhere, count: int, seed: int
) -> Story:
    """Ingest and projector over a log's windows, as `maps.py` and `integrity.py` run them."""
    case = read_case(listed.name, datasets / listed.folder, listed.log, listed.reference)
    chosen, (worse, truths) = thin(windows_of(case), count), worsened(case, way, seed)
    with tempfile.TemporaryDirectory() as scratch:
        write_map(worse.grid, Path(scratch) / "map.yaml")
        models = build(Path(scratch) / "map.yaml", MapbuilderSettings(), lambda _: None).models
    projector = ProjectorCore(ProjectorSettings())
    for model in models:
        if model.channel in projector.inputs:
            list(projector.handle(model))
    taped = list[Window]()
    for number, window in enumerate(chosen):
        received = case.log.between(window)
        stretch = faulty(fault, received, case.log, chosen, number, others)
        tap = Tap()
        loop = Loopback([ScanIngestCore(ScanIngestSettings()), projector, tap])
        loop.start()
        for envelope in stretch.received:
            loop.receive(envelope)
        loop.finish()
        stamps = sorted({e.stamp for e in stretch.received})
        at = [stretch.truth_at.get(own, own) for own in stamps]
        poses, known = truths.at(
            [own if there is None else there for own, there in zip(stamps, at, strict=True)]
        )
        truth = {
            own: None if there is None else tuple(pose.tolist())
            for own, there, pose, ok in zip(stamps, at, poses, known, strict=True)
            if ok or there is None
        }
        taped.append(Window(pack(tap.received), truth))
    return Story(pack(e for e in models if e.channel in TrackerCore.inputs), taped)


def kept(listed: Listed, way: str, fault: str, options: argparse.Namespace) -> Story:
    """A story from the folder, recorded first where it is not there."""
    name = f"{listed.name}-{way}-{fault}-{options.windows}-{options.seed}"
    for own, other in ((" ", "_"), ("%", "pc"), (",", ""), ("/", "-")):
        name = name.replace(own, other)
    path = options.keep / f"{name}.pickle.gz"
    if not path.exists():
        root, others = options.datasets, Elsewhere.of(listed.name, options.datasets)
        if options.buildings:
            root, logs = options.buildings, buildings(options.buildings)
            following = logs[(logs.index(listed) + 1) % len(logs)]
            others = Elsewhere(root / following.folder / following.log)
        story = record(listed, way, fault, root, others, options.windows, options.seed)
        path.parent.mkdir(parents=True, exist_ok=True)
        with gzip.open(path, "wb", compresslevel=1) as out:
            pickle.dump(story, out)
    with gzip.open(path) as file:
        loaded: Story = pickle.load(file)
    return loaded


def play(story: Story, settings: TrackerSettings) -> dict[str, float]:
    """The tracker over all windows of a story, judged."""
    success, false_windows, claims, false, high, highest, scans = [], [], 0, 0, 0, 0, 0
    for window in story.windows:
        core = TrackerCore(settings)
        for model in unpack(story.models):
            list(core.handle(model))
        published = [each for e in unpack(window.received) for each in core.handle(e)]
        published += core.finish()
        ok, claimed, sure = judged([e.open(PoseEstimate) for e in published if e.channel is POSE], window)
        wrong = claimed & ~ok
        good = claimed & ok
        since = sustained(good)
        success.append(since is not None and since <= (1 - LAST_SHARE) * len(good))
        false_windows.append(bool(wrong.any()))
        claims, false, scans = claims + int(claimed.sum()), false + int(wrong.sum()), scans + len(ok)
        high, highest = high + int((wrong & (sure > 0.9)).sum()), highest + int((wrong & (sure > 0.99)).sum())
    return {
        "success": float(np.mean(success)),
        "false_windows": float(np.mean(false_windows)),
        "false_share": false / max(claims, 1),
        "claimed": claims / max(scans, 1),
        "wrong_above_0.9": high,
        "wrong_above_0.99": highest,
        "scans": scans,
    }


def judged(poses: Sequence[PoseEstimate], window: Window) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each pose with a reference: whether it is right, whether it is claimed, and its confidence."""
    rows = list[tuple[bool, bool, float]]()
    for pose in poses:
        own = nanoseconds(pose.timestamp)
        if own in window.truth:
            truth, ok = window.truth[own], False
            if truth is not None:
                ok = bool(right(*errors(from_message(pose.pose)[None], np.array(truth)[None]))[0])
            rows.append((ok, pose.state == STATE_LOCALIZED, pose.confidence))
    table = np.array(rows, dtype=np.float64).reshape(-1, 3)
    return table[:, 0] > 0, table[:, 1] > 0, table[:, 2]


Patches = Sequence[tuple[Any, str, Any]]

MECHANISMS: Mapping[str, Patches] = {
    "as it is": (),
    "how far ahead": ((evidence, "LEAD", 0.0),),
    "how far behind": ((evidence, "BEHIND", 0.0),),
    "aliases": ((evidence, "ALIASES", 1e-12),),
    "places ahead together": ((evidence, "TOGETHER", 0.0),),
    "one turn shows a place": ((robot._Source, "new_turn", lambda _, moved, *__: moved.turn),),
    "places alike along a hallway": ((evidence, "ALIKE_M", 0.0),),
    "tracks that hide": ((evidence, "HIDES", 0.0),),
    "what lists leave out": ((belief, "MISSES", 0.0),),
    "slipped wheels": ((evidence, "SLIPS", 0.0),),
    "poor fits err more": ((observation, "POORER", 0.0),),
    "errors of a map that are alike": ((observation, "POINT_SIGMA", 1e9),),
    "evidence by place": ((branching, "LEAST_NEW", 1.0),),
    "kidnaps by broken lists": ((robot, "goes_on", lambda *_: None),),
    "kidnaps where lists fit other surfaces": ((robot, "THICK_M", 1e9),),
    "jumps of odometry": ((belief, "BREAK_SHARE", 0.0),),
    "off the map": ((floors, "_off_map_share", lambda _: 1e-9),),
    "more robots off an open map": ((floors, "_off_map_share", lambda _: belief.OFF_MAP_SHARE),),
    "scan motion corrects odometry": ((belief.Belief, "correct", lambda *_: None),),
    "scan motion against odometry": ((agreement.Agreement, "trust", property(lambda _: 1.0)),),
    "claims are withdrawn before they jump": ((claim.Claim, "_is_apart", lambda *_: False),),
    "new tracks keep their own mass": ((branching, "KEPT", 0.0),),
    "unification": ((unification, "SAME_DISTANCE2", 0.0),),
}
"""What stands in for each mechanism where it is left out."""


@contextmanager
def without(name: str) -> Iterator[None]:
    """The tracker without one mechanism."""
    with ExitStack() as stack:
        for owner, attribute, value in MECHANISMS[name]:
            stack.enter_context(mock.patch.object(owner, attribute, value))
        yield


COLUMNS = (
    ("success %", "success", 100.0),
    ("false windows %", "false_windows", 100.0),
    ("claims false %", "false_share", 100.0),
    ("claimed %", "claimed", 100.0),
    ("wrong > 0.9", "wrong_above_0.9", 1.0),
    ("> 0.99", "wrong_above_0.99", 1.0),
)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--keep", type=Path, required=True, help="folder of the recorded stories")
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--buildings", type=Path, help="folder of folders with logs of your own")
    parser.add_argument("--only", action="append", help="name of a log, or its folder; may be given again")
    parser.add_argument(
        "--way", action="append", choices=list(WAYS), help="may be given again; default: exact"
    )
    parser.add_argument(
        "--fault", action="append", choices=list(FAULTS), help="may be given again; default: none"
    )
    parser.add_argument("--without", action="append", choices=list(MECHANISMS), help="default: each in turn")
    parser.add_argument("--windows", type=int, default=8, help="of each log, at most")
    parser.add_argument("--seed", type=int, default=1, help="of the map made worse")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    logs = buildings(options.buildings) if options.buildings else LOGS
    rows = list[dict[str, Any]]()
    for listed in wanted(logs, options.only):
        for way in options.way or ["exact"]:
            for fault in options.fault or ["none"]:
                print(f"{listed.name}, {way}, {fault}: records what is not in {options.keep} yet", flush=True)
                story = kept(listed, way, fault, options)
                print(f"\n{listed.name}, map: {way}, fault: {fault}, {len(story.windows)} windows")
                print(f"  {'without':<40}" + "".join(f"{title:>17}" for title, _, _ in COLUMNS), flush=True)
                for name in options.without or MECHANISMS:
                    with without(name):
                        row = play(story, TrackerSettings())
                    rows.append({"log": listed.name, "map": way, "fault": fault, "without": name, **row})
                    print(
                        f"  {name:<40}" + "".join(f"{f * row[key]:17.1f}" for _, key, f in COLUMNS),
                        flush=True,
                    )
                    if options.json:
                        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
