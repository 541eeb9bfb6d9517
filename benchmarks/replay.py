"""Whether replays are identical, and how fast: the same recording again and again, into every core.

    python benchmarks/replay.py [--seconds 60] [--rate 10] [--beams 361] [--times 10] [--json OUT]

A simulated drive through the demo's building. The pipeline (raw scans and odometry in, poses out) is replayed
on one core, as fast as it can and at the drive's own pace; each run is judged by SHA-256 over all that the
cores report. Processor time counts from the first input on, when the models are in place; reading is in it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.wire import encode
from eigenscan.workbench.one_thread import one_thread
from eigenscan.workbench.replay.casting import cast
from eigenscan.workbench.replay.playing import Event, Side, play
from eigenscan.workbench.replay.services import PARTS
from eigenscan.workbench.replay.survey import Survey, survey
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.live import Metronome
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of the drive")
    parser.add_argument("--rate", type=float, default=10.0, help="scans a second")
    parser.add_argument("--beams", type=int, default=361)
    parser.add_argument("--times", type=int, default=10, help="replays as fast as it can")
    parser.add_argument("--paced", type=int, default=1, help="replays at the drive's own pace")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    one_thread()
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "drive.mcap"
        record(recording, Scenario(seconds=given.seconds, lidar=Lidar(beams=given.beams, rate=given.rate)))
        found = survey(recording)
        published(found, paced=False)  # compiled now
        runs = [published(found, paced=False) for _ in range(given.times)]
        paced = [published(found, paced=True) for _ in range(given.paced)]
    sums = [sums for sums, _ in [*runs, *paced]]
    processor_s = sorted(used for _, used in runs)
    figures = {
        "drive_s": found.seconds,
        "scans": found.seconds * given.rate,
        "replays": len(runs),
        "replays_at_its_own_pace": len(paced),
        "channels_identical": sum(all(one[name] == sums[0][name] for one in sums) for name in sums[0]),
        "channels": len(sums[0]),
        "times_real_time_median": found.seconds / processor_s[len(processor_s) // 2],
        "times_real_time_worst": found.seconds / processor_s[-1],
        "processor_ms_a_scan": processor_s[len(processor_s) // 2] * 1e3 / (found.seconds * given.rate),
    }
    for name, value in figures.items():
        print(f"{name:28} {value:10.1f}")
    if given.json:
        given.json.write_text(json.dumps(figures | {"sha256": sums[0]}, indent=1) + "\n")


def record(target: Path, scenario: Scenario) -> None:
    """Models, raw scans and odometry; the cores' answers are those of the replays."""
    grid = office().render()
    models = MapbuilderCore(MapbuilderSettings(), build_site(grid, Plan())).start()
    stage = Stage(grid, scenario)
    with RecordingWriter(target) as writer:
        for envelope in models:
            writer.write(envelope, stage.epoch)
        for timed in stage.messages():
            writer.write(timed.envelope, timed.time)


def published(found: Survey, *, paced: bool) -> tuple[dict[str, str], float]:
    """SHA-256 of all that is published, by channel; and processor time, s, from the first input on."""
    sums: dict[str, hashlib._Hash] = defaultdict(hashlib.sha256)
    began = 0.0
    events = play(found, PARTS, cast(found, PARTS, {}))
    for event in in_time(events) if paced else events:
        if not began and not event.envelope.channel.qos.latched:
            began = time.process_time()
        if event.side is Side.REPLAYED:
            sums[event.envelope.channel.name].update(encode(event.envelope.message))
    return {name: one.hexdigest() for name, one in sums.items()}, time.process_time() - began


def in_time(events: Iterator[Event]) -> Iterator[Event]:
    """Holds each event back until its time has come."""
    metronome = Metronome()
    for event in events:
        time.sleep(max(0.0, metronome.rest(event.time)))
        yield event


if __name__ == "__main__":
    main()
