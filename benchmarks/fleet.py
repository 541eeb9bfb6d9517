"""How many robots one machine takes: scan to pose over a real router, services that all robots share.

    .venv/bin/python benchmarks/fleet.py [--robots 1,10,20,40,80,200] [--groups 1] [--parts 1]
                                         [--rate 10] [--seconds 10] [--json OUT]

Each robot reports --rate canonical scans of 361 beams and five times as many odometries a second, computed
before. On the same machine run a router, a mapbuilder, and for each of --groups groups of the robots a
tracker and --parts projectors, which share the site's regions. It ends where fewer than 95 % of the scans
become poses. "ms a scan" is processor time, of the process and of its core alone, called in this process over
the same scans right before: that shows how fast the machine is. "sent" is how many scans the
robots got rid of, latency from a scan's publication to its pose's arrival, "wrong" the share of claims over
0.5 m off, and air is what leaves a robot by the contract: poses at 10 Hz, tracks at 1 Hz and its services'
healths, payload and key.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.eigenspace.folder import read_models
from eigenscan.geometry.gridmap import to_message, write_map
from eigenscan.mapbuilder.core import announce_models
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import (
    HEALTH,
    HYPOTHESES,
    MAP,
    MODEL_SET,
    POSE,
    SCAN,
    TRACKS,
)
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from fleet_robots import RATE_HZ, SITE, SPREAD_S, Received, canonical, drive, name_of

PROGRAM = Path(sys.executable).with_name("eigenscan")
SETTLE_S = 5.0
ENOUGH = 0.95
ALONE_SCANS = 150


def cores_alone(folder: Path, published: list[tuple[int, Envelope]]) -> dict[str, float]:
    """Processor time, ms a scan, of the two cores without processes and without Zenoh."""
    projector, tracker = ProjectorCore(ProjectorSettings()), TrackerCore(TrackerSettings())
    for model in announce_models(read_models(folder / "model"), SITE):
        projector.handle(model)
    projector.handle(Envelope(MAP, {"site": SITE}, to_message(read_models(folder / "model").grid, "map")))
    spent, scans = {"projector": 0.0, "tracker": 0.0}, 0
    address = {"site": SITE, "robot": "r", "lidar": "front"}
    for at, envelope in published[: 60 * ALONE_SCANS // 10]:
        envelope.message.timestamp.CopyFrom(stamp(at))  # type: ignore[attr-defined]
        received = [Envelope(envelope.channel, address, envelope.message)]
        began = time.thread_time()
        if envelope.channel is SCAN:
            received = [each for each in projector.handle(received[0]) if each.channel is HYPOTHESES]
        between = time.thread_time()
        for each in received:
            list(tracker.handle(each))
        if scans >= ALONE_SCANS // 10:  # what is compiled or made at the first is not what a scan costs
            spent["projector"] += between - began
            spent["tracker"] += time.thread_time() - between
        scans += envelope.channel is SCAN
    return {name: one / (scans - ALONE_SCANS // 10) * 1e3 for name, one in spent.items()}


@contextmanager
def services(
    folder: Path, config: Path, router: Path, parts: int, groups: int
) -> Iterator[dict[str, psutil.Process]]:
    """The processes that robots share, by name."""
    with Supervisor(folder / "logs") as supervisor:
        supervisor.start("router", "eigenscan.runtime.router", ["--site", SITE, "--zenoh", str(router)])
        site = ["--site", SITE, "--zenoh", str(config)]
        supervisor.start("mapbuilder", SERVICES["mapbuilder"], [*site, "--model", str(folder / "model")])
        for group in range(groups):
            shared = [*site, "--robot", f"g{group}-*"]
            supervisor.start(f"tracker {group}", SERVICES["tracker"], shared)
            for part in range(1, parts + 1):
                own = ["--part", f"{part}/{parts}"]
                supervisor.start(f"projector {group} {part}", SERVICES["projector"], [*shared, *own])
        yield {name: psutil.Process(child.process.pid) for name, child in supervisor.children.items()}


def measure(
    session: zenoh.Session,
    stage: Stage,
    published: list[tuple[int, Envelope]],
    names: list[str],
    seconds: float,
    processes: dict[str, psutil.Process],
) -> dict[str, Any]:
    """One row of the table."""
    received, stop = Received(stage), threading.Event()
    everywhere = {"site": SITE}
    ears = [
        session.declare_subscriber(channel.selector(everywhere), on)
        for channel, on in (
            (POSE, received.on_pose),
            (TRACKS, received.on_tracks),
            (HEALTH, received.on_health),
        )
    ]
    bus = Bus(session)
    driving = threading.Thread(target=drive, args=(bus, published, names, received, stop))
    driving.start()
    time.sleep(SETTLE_S)
    used = {name: process.cpu_times() for name, process in processes.items()}
    received.begin = time.monotonic()
    time.sleep(seconds)
    received.end = time.monotonic()
    spent = {
        name: (sum(process.cpu_times()[:2]) - sum(used[name][:2])) / seconds
        for name, process in processes.items()
    }
    time.sleep(1.0)  # answers that are under way
    stop.set()
    driving.join()
    for ear in ears:
        ear.undeclare()
    waits = np.array(received.waits or [np.nan])
    return {
        "robots": len(names),
        "scans_per_s": received.published / seconds,
        "ms_per_scan": {
            kind: total(spent, kind) * seconds * 1e3 / max(len(received.waits), 1)
            for kind in ("projector", "tracker")
        },
        "load": psutil.getloadavg()[0],
        "answered": len(received.waits) / max(received.published, 1),
        "p50_ms": float(np.median(waits)) * 1e3,
        "p99_ms": float(np.quantile(waits, 0.99)) * 1e3,
        "claims_wrong": received.wrong / max(received.claims, 1),
        "claimed": received.claims / max(len(received.waits), 1),
        "cores": spent,
        "rss_mb": {name: process.memory_info().rss / 1e6 for name, process in processes.items()},
        "air_bytes_per_s": received.air(received.published / seconds / len(names)),
    }


def total(figures: dict[str, float], kind: str) -> float:
    """Of all processes of one kind."""
    return sum(value for name, value in figures.items() if name.partition(" ")[0] == kind)


def wait_for_models(session: zenoh.Session, parts: int) -> None:
    """Until every projector reports that it has them."""
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
    cores, rss, ms = row["cores"], row["rss_mb"], row["ms_per_scan"]
    core = row["alone_ms"]
    return (
        f"{row['robots']:6} {row['scans_per_s']:7.0f} {row['answered']:8.1%} {row['p50_ms']:7.1f} "
        f"{row['p99_ms']:7.1f} {row['claims_wrong']:6.1%} |       {cores['router']:6.2f} "
        f"{total(cores, 'projector'):9.2f} {total(cores, 'tracker'):7.2f} {cores['mapbuilder']:10.2f} |"
        f"    {rss['router']:6.0f} {total(rss, 'projector'):9.0f} {total(rss, 'tracker'):7.0f} |"
        f" {ms['projector']:5.1f} ({core['projector']:4.1f}) {ms['tracker']:5.1f} ({core['tracker']:4.1f}) |"
        f" {row['air_bytes_per_s']:7.0f} {row['load']:5.1f}"
    )


def prepare(folder: Path, stage: Stage, **settings: Any) -> tuple[Path, Path]:
    """Builds the stage's models into `folder`; gives Zenoh's configurations: a router's, and its clients'."""
    write_map(stage.grid, folder / "map.yaml")
    subprocess.run(
        [PROGRAM, "build", folder / "map.yaml", "-o", folder / "model"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    endpoint = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
    alone = {"scouting": {"multicast": {"enabled": False}}} | settings
    router, config = folder / "router.json5", folder / "client.json5"
    router.write_text(json.dumps(alone | {"mode": "router", "listen": endpoint}))
    patient = endpoint | {"timeout_ms": -1, "exit_on_failure": False}
    config.write_text(json.dumps(alone | {"mode": "client", "connect": patient}))
    return router, config


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", default="1,10,20,40,80,200")
    parser.add_argument("--groups", type=int, default=1)
    parser.add_argument("--parts", type=int, default=1)
    parser.add_argument("--rate", type=float, default=RATE_HZ, help="scans a second of a robot, at most 10")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    seconds = arguments.seconds
    length = SPREAD_S + SETTLE_S + seconds + 3.0
    stage = Stage(office().render(), Scenario(seconds=length, seed=3, people=2, site=SITE))
    rows = []
    print(
        f"{'robots':>6} {'sent/s':>7} {'answered':>8} {'p50 ms':>7} {'p99 ms':>7} {'wrong':>6} "
        f"| cores {'router':>6} {'projector':>9} {'tracker':>7} {'mapbuilder':>10} | MB {'router':>6} "
        f"{'projector':>9} {'tracker':>7} | ms a scan (core alone)    | {'air B/s':>7} {'load':>5}"
    )
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        router, config = prepare(folder, stage)
        processes = stack.enter_context(services(folder, config, router, arguments.parts, arguments.groups))
        session = stack.enter_context(open_session(config))
        wait_for_models(session, arguments.parts * arguments.groups)
        published = canonical(stage, arguments.rate)
        for robots in map(int, arguments.robots.split(",")):
            own = cores_alone(folder, canonical(stage, RATE_HZ))
            names = [name_of(robot, arguments.groups) for robot in range(robots)]
            rows.append(measure(session, stage, published, names, seconds, processes) | {"alone_ms": own})
            print(row_text(rows[-1]), flush=True)
            if rows[-1]["answered"] < ENOUGH:
                break
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
