"""What recording many robots costs: drops, share of a core, bytes a scan beside the raw size and zstd of it.

    python benchmarks/recording.py [--robots 50] [--rate 10] [--beams 361] [--seconds 20] [--kills 20]

A recorder process on loopback TCP; raw scans of a simulated robot, which all robots report, each from another
moment on, with noise of their own and in whole millimetres, as lidars have it. Then recorders that are killed
at random moments: what is lost is what was published, at 250 Hz, after the last message in the file.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import psutil
import zstandard
from eigenscan.cli.launch.network import open_hub
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import HEALTH, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import decode, encode
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

SITE = "benchmark"
SIMULATED_S, NOISE_M = 10.0, 0.015
READY_S, SETTLE_S = 60.0, 3.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--rate", type=float, default=10.0, help="scans a second of each")
    parser.add_argument("--beams", type=int, default=361)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    scenario = Scenario(seconds=SIMULATED_S, lidar=Lidar(beams=given.beams, rate=given.rate))
    stage = Stage(office().render(), scenario)
    scans = [t.envelope.open(RawScan) for t in stage.messages() if t.envelope.channel is SCAN_RAW]
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(Path(folder), scans, given.robots, given.rate, given.seconds)
    random = np.random.default_rng(1)
    lost = []
    for _ in range(given.kills):
        with tempfile.TemporaryDirectory() as folder:
            lost.append(lost_by_a_kill(Path(folder), float(random.uniform(1.0, 3.0))))
    if lost:
        figures |= {"kills": len(lost), "lost_s_median": float(np.median(lost)), "lost_s_worst": max(lost)}
    for name, value in figures.items():
        print(f"{name:32} {value:12.2f}")
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n")


def measure(folder: Path, scans: list[RawScan], robots: int, rate: float, seconds: float) -> dict[str, float]:
    session, others = open_hub(folder)
    recording = folder / "site.mcap"
    with Bus(session) as bus:
        inbox = Inbox()
        bus.listen([HEALTH], {"site": SITE}, inbox)
        recorder = start(recording, others)
        try:
            await_health(inbox, READY_S)
            before, began = cpu_s(recorder.pid), time.monotonic()
            published = publish(bus, scans, robots, rate, seconds)
            took = time.monotonic() - began
            used = cpu_s(recorder.pid) - before
            time.sleep(SETTLE_S)
            health = await_health(inbox, READY_S)
        finally:
            recorder.terminate()
            recorder.wait()
    kept = [r for r in read(recording) if r.envelope.channel is SCAN_RAW]
    payloads = [encode(record.envelope.message) for record in kept]
    dropped = sum(count for name, count in health.counters.items() if name.startswith("dropped_"))
    return {
        "scans_said": published,
        "scans_a_second": published / took,
        "scans_recorded": len(kept),
        "dropped_by_recorder": dropped,
        "recorder_share_of_a_core": used / took,
        "recorder_slowest_write_ms": health.counters["mcap_slowest_ms"],
        "bytes_a_scan_in_the_file": recording.stat().st_size / max(len(kept), 1),
        "bytes_a_scan_raw": sum(map(len, payloads)) / max(len(kept), 1),
        "bytes_a_scan_zstd_of_all": len(zstandard.compress(b"".join(payloads))) / max(len(kept), 1),
    }


def start(recording: Path, zenoh: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "eigenscan.recorder.node", "--site", SITE, "--zenoh", str(zenoh)]
    with recording.with_suffix(".log").open("wb") as log:
        return subprocess.Popen([*command, "--mcap", str(recording)], stdout=log, stderr=log)


def lost_by_a_kill(folder: Path, after_s: float) -> float:
    """Seconds before the kill from which nothing is in the file. Raises where it cannot be read."""
    session, others = open_hub(folder)
    recording, address = folder / "site.mcap", {"site": SITE, "robot": "r1"}
    with Bus(session) as bus:
        inbox = Inbox()
        bus.listen([HEALTH], {"site": SITE}, inbox)
        recorder = start(recording, others)
        await_health(inbox, READY_S)
        end = time.monotonic() + after_s
        while time.monotonic() < end:
            bus.publish(Envelope(POSE, address, PoseEstimate(timestamp=stamp(time.time_ns()))))
            time.sleep(0.004)
        recorder.kill()
        killed = time.time_ns()
        recorder.wait()
    kept = [record.publish_time for record in read(recording) if record.envelope.channel is POSE]
    return (killed - max(kept, default=killed - int(after_s * 1e9))) * 1e-9


def publish(bus: Bus, scans: list[RawScan], robots: int, rate: float, seconds: float) -> int:
    """Publishes a scan of every robot, spread over each period; the number of scans."""
    period, published = 1.0 / rate, 0
    random = np.random.default_rng(1)
    ranges = np.array([scan.ranges for scan in scans])
    began = time.monotonic()
    for turn in range(int(seconds * rate)):
        for robot in range(robots):
            due = began + (turn + robot / robots) * period
            time.sleep(max(0.0, due - time.monotonic()))
            number = (turn + 7 * robot) % len(scans)
            scan = scans[number]
            noise = random.normal(0.0, NOISE_M, ranges.shape[1])
            scan.ranges[:] = np.round(ranges[number] + noise, 3).tolist()
            scan.timestamp.CopyFrom(stamp(time.time_ns()))
            address = {"site": SITE, "robot": f"r{robot}", "lidar": "front"}
            bus.publish(Envelope(SCAN_RAW, address, scan))
            published += 1
    return published


def await_health(inbox: Inbox, timeout: float) -> Health:
    """The newest health of the recorder, once there is one."""
    deadline, newest = time.monotonic() + timeout, None
    while time.monotonic() < deadline:
        arrival = inbox.take(0.1)
        if arrival is None and newest is not None:
            return newest
        if arrival is not None:
            message = decode(HEALTH, arrival.payload)
            assert isinstance(message, Health)
            newest = message
    raise SystemExit("the recorder says nothing of itself")


def cpu_s(pid: int) -> float:
    times = psutil.Process(pid).cpu_times()
    return times.user + times.system


if __name__ == "__main__":
    main()
