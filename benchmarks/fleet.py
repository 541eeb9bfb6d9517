"""How many robots one machine takes: scan to pose over a real router, services that all robots share.

    .venv/bin/python benchmarks/fleet.py [--robots 1,10,20,40,80,200] [--parts 1] [--seconds 10] [--json OUT]

Each robot says 10 canonical scans of 361 beams and 50 odometries a second, computed before. On the same
machine run a router, a mapbuilder, one tracker and --parts projectors, which share the site's regions, for
all robots. It ends where fewer than 95 % of the scans become poses. "said" is how many scans the robots got
rid of, latency from a scan's publication to its pose's arrival, "wrong" the share of claims over 0.5 m off,
and air is what leaves a robot by the contract: poses at 10 Hz, tracks at 1 Hz and its services' healths,
payload and key.
"""

import argparse
import heapq
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.cli.simulation.stage import Scenario, Stage
from eigenscan.cli.simulation.world import office
from eigenscan.geometry.gridmap import write_map
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, MODEL_SET, ODOMETRY, POSE, SCAN, SCAN_RAW, TRACKS
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

PROGRAM = Path(sys.executable).with_name("eigenscan")
SITE = "scale"
SPREAD_S = 20.0
"""The robots follow each other along one drive, within so many seconds."""
SETTLE_S = 5.0
ENOUGH = 0.95
RIGHT_M = 0.5
RATE_HZ = 10.0
ON_ROBOT = ("scan-ingest", "projector", "tracker")


@dataclass
class Heard:
    """What came back within the window."""

    stage: Stage
    begin: float = np.inf
    end: float = np.inf
    sent: dict[tuple[str, int], tuple[float, int]] = field(default_factory=dict)
    """Robot and stamp -> when the scan was said, s, and its time in the drive, ns."""
    said: int = 0
    waits: list[float] = field(default_factory=list)
    wrong: int = 0
    claims: int = 0
    sizes: dict[str, list[int]] = field(default_factory=lambda: {"pose": [], "tracks": [], "health": []})

    def on_pose(self, sample: zenoh.Sample) -> None:
        now = time.monotonic()
        self._size("pose", sample)
        pose = PoseEstimate.FromString(sample.payload.to_bytes())
        said = self.sent.pop((str(sample.key_expr).split("/")[2], nanoseconds(pose.timestamp)), None)
        if said is None or not self.begin <= said[0] < self.end:
            return
        self.waits.append(now - said[0])
        if pose.state == STATE_LOCALIZED:
            x, y, _ = self.stage.pose_at(said[1])
            self.claims += 1
            self.wrong += bool(np.hypot(pose.pose.x - x, pose.pose.y - y) > RIGHT_M)

    def on_tracks(self, sample: zenoh.Sample) -> None:
        self._size("tracks", sample)

    def on_health(self, sample: zenoh.Sample) -> None:
        self._size("health", sample)

    def _size(self, name: str, sample: zenoh.Sample) -> None:
        self.sizes[name].append(len(sample.payload) + len(str(sample.key_expr)))

    def air(self) -> float:
        """Bytes a second that leave one robot."""
        typical = {name: float(np.mean(sizes or [0])) for name, sizes in self.sizes.items()}
        return RATE_HZ * typical["pose"] + typical["tracks"] + len(ON_ROBOT) * typical["health"]


def canonical(stage: Stage) -> list[tuple[int, Envelope]]:
    """Time in the drive, ns, and what the robot says then: canonical scans and odometry."""
    ingest, said = ScanIngestCore(ScanIngestSettings()), []
    for timed in stage.messages():
        if timed.envelope.channel is SCAN_RAW:
            said += [(timed.time, envelope) for envelope in ingest.handle(timed.envelope)]
        elif timed.envelope.channel is ODOMETRY:
            said.append((timed.time, timed.envelope))
    return said


def drive(
    bus: Bus, said: list[tuple[int, Envelope]], robots: int, heard: Heard, stop: threading.Event
) -> None:
    """Says what `robots` robots say, each message when its time has come, with stamps of now."""
    first, began = said[0][0], time.monotonic()
    wall = time.time_ns()
    times = np.array([at for at, _ in said])
    due: list[tuple[float, int, int, int]] = []
    for robot in range(robots):
        offset = int(robot * SPREAD_S / robots * 1e9)
        begin = int(np.searchsorted(times, first + offset))
        # robots are not in step: each has its own moment within the tenth of a second
        heapq.heappush(due, (robot / robots / RATE_HZ, robot, begin, int(times[begin])))
    while due and not stop.is_set():
        at, robot, index, origin = heapq.heappop(due)
        if (wait := began + at - time.monotonic()) > 0 and stop.wait(wait):
            return
        drive_time, envelope = said[index]
        now = wall + int(at * 1e9)
        envelope.message.timestamp.CopyFrom(stamp(now))  # type: ignore[attr-defined]
        name = f"r{robot}"
        if envelope.channel is SCAN:
            moment = time.monotonic()
            heard.sent[name, now] = (moment, drive_time)
            heard.said += heard.begin <= moment < heard.end
        bus.say(Envelope(envelope.channel, {"site": SITE, "robot": name, "lidar": "front"}, envelope.message))
        if index + 1 < len(said):
            later = (said[index + 1][0] - drive_time) * 1e-9
            heapq.heappush(due, (at + later, robot, index + 1, origin))


@contextmanager
def services(folder: Path, config: Path, router: Path, parts: int) -> Iterator[dict[str, psutil.Process]]:
    """The processes that all robots share, by name."""
    with Supervisor(folder / "logs") as supervisor:
        supervisor.start("router", "eigenscan.runtime.router", ["--site", SITE, "--zenoh", str(router)])
        shared = ["--site", SITE, "--robot", "*", "--zenoh", str(config)]
        supervisor.start("mapbuilder", SERVICES["mapbuilder"], [*shared, "--model", str(folder / "model")])
        supervisor.start("tracker", SERVICES["tracker"], shared)
        for part in range(1, parts + 1):
            own = ["--part", f"{part}/{parts}", "--instance", f"p{part}"]
            supervisor.start(f"projector {part}", SERVICES["projector"], [*shared, *own])
        yield {name: psutil.Process(child.process.pid) for name, child in supervisor.children.items()}


def measure(
    session: zenoh.Session, stage: Stage, robots: int, seconds: float, processes: dict[str, psutil.Process]
) -> dict[str, Any]:
    """One row of the table."""
    heard, stop = Heard(stage), threading.Event()
    everywhere = {"site": SITE}
    ears = [
        session.declare_subscriber(channel.selector(everywhere), on)
        for channel, on in ((POSE, heard.on_pose), (TRACKS, heard.on_tracks), (HEALTH, heard.on_health))
    ]
    bus = Bus(session)
    driving = threading.Thread(target=drive, args=(bus, canonical(stage), robots, heard, stop))
    driving.start()
    time.sleep(SETTLE_S)
    used = {name: process.cpu_times() for name, process in processes.items()}
    heard.begin = time.monotonic()
    time.sleep(seconds)
    heard.end = time.monotonic()
    spent = {
        name: (sum(process.cpu_times()[:2]) - sum(used[name][:2])) / seconds
        for name, process in processes.items()
    }
    time.sleep(1.0)  # answers that are under way
    stop.set()
    driving.join()
    for ear in ears:
        ear.undeclare()  # type: ignore[no-untyped-call]
    waits = np.array(heard.waits or [np.nan])
    return {
        "robots": robots,
        "scans_per_s": heard.said / seconds,
        "answered": len(heard.waits) / max(heard.said, 1),
        "p50_ms": float(np.median(waits)) * 1e3,
        "p99_ms": float(np.quantile(waits, 0.99)) * 1e3,
        "claims_wrong": heard.wrong / max(heard.claims, 1),
        "claimed": heard.claims / max(len(heard.waits), 1),
        "cores": spent,
        "rss_mb": {name: process.memory_info().rss / 1e6 for name, process in processes.items()},
        "air_bytes_per_s": heard.air(),
    }


def wait_for_models(session: zenoh.Session, parts: int) -> None:
    """Until every projector says that it has them."""
    ready: set[str] = set()

    def on_health(sample: zenoh.Sample) -> None:
        health = Health.FromString(sample.payload.to_bytes())
        if health.service == "projector" and health.status == Health.STATUS_OK:
            ready.add(health.instance)

    with session.declare_subscriber(HEALTH.selector({"site": SITE}), on_health):
        deadline = time.monotonic() + 120.0
        while len(ready) < parts:
            if time.monotonic() > deadline:
                raise SystemExit(f"{MODEL_SET.name}: not all projectors are ready")
            time.sleep(0.1)


def row_text(row: dict[str, Any]) -> str:
    cores, rss = row["cores"], row["rss_mb"]
    projectors = [name for name in cores if name.startswith("projector")]
    return (
        f"{row['robots']:6} {row['scans_per_s']:7.0f} {row['answered']:8.1%} {row['p50_ms']:7.1f} "
        f"{row['p99_ms']:7.1f} {row['claims_wrong']:6.1%} |       {cores['router']:6.2f} "
        f"{sum(cores[name] for name in projectors):9.2f} {cores['tracker']:7.2f} |    {rss['router']:6.0f} "
        f"{sum(rss[name] for name in projectors):9.0f} {rss['tracker']:7.0f} | {row['air_bytes_per_s']:7.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", default="1,10,20,40,80,200")
    parser.add_argument("--parts", type=int, default=1)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    seconds = arguments.seconds
    length = SPREAD_S + SETTLE_S + seconds + 3.0
    stage = Stage(office().render(), Scenario(seconds=length, seed=3, people=2, site=SITE))
    rows = []
    print(
        f"{'robots':>6} {'said/s':>7} {'answered':>8} {'p50 ms':>7} {'p99 ms':>7} {'wrong':>6} "
        f"| cores {'router':>6} {'projector':>9} {'tracker':>7} | MB {'router':>6} {'projector':>9} "
        f"{'tracker':>7} | {'air B/s':>7}"
    )
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write_map(stage.grid, folder / "map.yaml")
        subprocess.run(
            [PROGRAM, "build", folder / "map.yaml", "-o", folder / "model"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        endpoint = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
        alone: dict[str, Any] = {"scouting": {"multicast": {"enabled": False}}}
        router, config = folder / "router.json5", folder / "client.json5"
        router.write_text(json.dumps(alone | {"mode": "router", "listen": endpoint}))
        config.write_text(json.dumps(alone | {"mode": "client", "connect": endpoint | {"timeout_ms": -1}}))
        processes = stack.enter_context(services(folder, config, router, arguments.parts))
        session = stack.enter_context(open_session(config))
        wait_for_models(session, arguments.parts)
        for robots in map(int, arguments.robots.split(",")):
            rows.append(measure(session, stage, robots, seconds, processes))
            print(row_text(rows[-1]), flush=True)
            if rows[-1]["answered"] < ENOUGH:
                break
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
