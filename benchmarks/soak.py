"""Robots without end: what memory and open files of a site's services do meanwhile.

    .venv/bin/python benchmarks/soak.py [--robots 600] [--restarts 3] [--json OUT]

Each robot has a name and a session of its own, publishes 10 raw scans and 500 odometries as fast as they are
taken, waits for the pose of its last scan and is gone for good. Router, mapbuilder, scan-ingest, projector,
tracker (each for all robots), recorder and `fleet metrics` are processes; the router is killed and started
again --restarts times within the first half. A row is a tenth of the robots: memory, MB, and open files of
each process. A tracker forgets who was silent for 100,000 messages, so its memory grows until then and no
more: "growth" is that of the last half.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import PATIENT_QUEUE
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, ODOMETRY, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from fleet_robots import SITE

from fleet import PROGRAM, prepare, wait_for_models

SCANS, ODOMETRIES = 10, 500
ROWS = 10
ENOUGH = 0.99
"""Of the robots that get the pose of their last scan; one or two meet a router that is just gone."""
POSE_S, READY_S = 5.0, 60.0
"""What a robot waits for the pose of its last scan, and who waits for services."""
SHARED = ("scan-ingest", "projector", "tracker", "recorder", "mapbuilder")


def script(stage: Stage) -> list[Envelope]:
    """What each robot reports: odometry, and scans between."""
    published = [timed.envelope for timed in stage.messages()]
    scans = [one for one in published if one.channel is SCAN_RAW][:SCANS]
    odometries = [one for one in published if one.channel is ODOMETRY][:ODOMETRIES]
    every = len(odometries) // len(scans)
    return [
        one
        for number, odometry in enumerate(odometries)
        for one in ([odometry, scans[number // every]] if number % every == 0 else [odometry])
    ]


def visit(config: Path, name: str, published: list[Envelope]) -> bool:
    """One robot, from its coming to its going; whether it got the pose of its last scan."""
    found = threading.Event()
    now = time.time_ns() - len(published) * 2_000_000
    last = now + max(number for number, one in enumerate(published) if one.channel is SCAN_RAW) * 2_000_000

    def on_pose(sample: zenoh.Sample) -> None:
        pose = POSE.message.FromString(sample.payload.to_bytes())
        if pose.timestamp == stamp(last):  # type: ignore[attr-defined]
            found.set()

    with open_session(config) as session:
        address = {"site": SITE, "robot": name, "lidar": "front"}
        session.declare_subscriber(POSE.key(address), on_pose)
        bus = Bus(session)
        for channel in (SCAN_RAW, ODOMETRY):
            bus.wait_for_listener(channel.key(address), READY_S)
        for number, one in enumerate(published):
            one.message.timestamp.CopyFrom(stamp(now + number * 2_000_000))  # type: ignore[attr-defined]
            bus.publish(Envelope(one.channel, address, one.message))
            if one.channel is SCAN_RAW:
                time.sleep(0.005)
        return found.wait(POSE_S)


def wait_for_services(config: Path) -> None:
    """Until each has reported how it is, over the router that is there now."""
    received: set[str] = set()
    with open_session(config) as session:
        everyone = HEALTH.selector({"site": SITE})
        session.declare_subscriber(everyone, lambda sample: received.add(str(sample.key_expr).split("/")[2]))
        deadline = time.monotonic() + READY_S
        while not set(SHARED) <= received:
            if time.monotonic() > deadline:
                raise SystemExit(f"not heard of: {', '.join(sorted(set(SHARED) - received))}")
            time.sleep(0.1)


def sizes(processes: dict[str, psutil.Process]) -> dict[str, dict[str, float]]:
    return {
        name: {"mb": one.memory_info().rss / 1e6, "files": one.num_fds()} for name, one in processes.items()
    }


def soak(options: argparse.Namespace, folder: Path, supervisor: Supervisor) -> dict[str, Any]:
    stage = Stage(office().render(), Scenario(seconds=ODOMETRIES / 50 + 2, seed=3, people=2, site=SITE))
    # faster than real time: what waits for the link must not be dropped
    queues = {"link": {"tx": {"queue": PATIENT_QUEUE}}}
    router, config = prepare(folder, stage, transport=queues)

    def start_router(number: int) -> psutil.Process:
        name = f"router {number}"
        supervisor.start(name, "eigenscan.runtime.router", ["--site", SITE, "--zenoh", str(router)])
        return psutil.Process(supervisor.children[name].process.pid)

    processes = {"router": start_router(0)}
    own = {"mapbuilder": ["--model", str(folder / "model")]}
    own["recorder"] = ["--mcap", str(folder / "recordings"), "--rotate-mb", "5", "--budget-mb", "20"]
    for service in SHARED:
        shared = ["--site", SITE, "--robot", "*", "--zenoh", str(config), *own.get(service, [])]
        supervisor.start(service, SERVICES[service], shared)
        processes[service] = psutil.Process(supervisor.children[service].process.pid)
    command = [PROGRAM, "fleet", "metrics", "--site", SITE, "--zenoh", config, "--port", "0"]
    metrics = subprocess.Popen([*map(str, command)], stdout=subprocess.DEVNULL)
    processes["metrics"] = psutil.Process(metrics.pid)
    try:
        with open_session(config) as session:
            wait_for_models(session, 1)
        wait_for_services(config)
        published, answered = script(stage), 0
        rows: list[dict[str, Any]] = [{"robots": 0, **sizes(processes)}]
        print_row(rows[0], head=True)
        began, restarted = time.monotonic(), 0
        for number in range(options.robots):
            answered += visit(config, f"r{number}", published)
            # in the first half, so that the growth of the second is the robots' alone
            if (number + 1) * 2 * (options.restarts + 1) // options.robots > restarted < options.restarts:
                restarted += 1
                processes["router"].kill()
                processes["router"].wait()
                processes["router"] = start_router(restarted)
                wait_for_services(config)
            if (number + 1) % max(options.robots // ROWS, 1) == 0:
                rows.append({"robots": number + 1, **sizes(processes)})
                print_row(rows[-1])
        seconds = time.monotonic() - began
    finally:
        metrics.terminate()
        metrics.wait()
    half = [row for row in rows if row["robots"] >= options.robots // 2]
    robots = np.array([row["robots"] for row in half])
    growth = {
        name: float(np.polyfit(robots, [row[name]["mb"] for row in half], 1)[0]) * 1e3 for name in processes
    }
    return {
        "robots": options.robots, "answered": answered, "seconds": seconds, "restarts": restarted,
        "messages": options.robots * len(published), "growth_kb_per_robot": growth,
        "files_more": {n: rows[-1][n]["files"] - rows[1][n]["files"] for n in processes}, "rows": rows,
    }  # fmt: skip


def print_row(row: dict[str, Any], head: bool = False) -> None:
    names = [name for name in row if name != "robots"]
    if head:
        print(f"{'robots':>6} | " + " ".join(f"{name:>14}" for name in names) + "   (MB, files)")
    cells = [f"{row[name]['mb']:8.1f} {row[name]['files']:5.0f}" for name in names]
    print(f"{row['robots']:6} | " + " ".join(cells), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", type=int, default=600)
    parser.add_argument("--restarts", type=int, default=3, help="of the router")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        found = soak(options, folder, stack.enter_context(Supervisor(folder / "logs")))
    print(
        f"{found['robots']} robots, {found['messages']} messages, {found['answered']} last poses, router "
        f"started again {found['restarts']} times, {found['seconds']:.0f} s"
    )
    words = ", ".join(f"{name} {kb:.0f}" for name, kb in found["growth_kb_per_robot"].items())
    print(f"growth over the last half, kB a robot: {words}")
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    sys.exit(0 if found["answered"] >= ENOUGH * found["robots"] else 1)


if __name__ == "__main__":
    main()
