"""What the ROS bridge costs: latency that it adds to each topic, and CPU for each message.

    python benchmarks/ros_bridge.py [--rate 50] [--seconds 20] [--beams 720] [--json OUT]
    chrt -f 10 python benchmarks/ros_bridge.py        # where the machine has other work to do

One process sends a ROS message, and receives what the bridge, a process of its own, makes of it; in turn with
that it sends the same bytes straight to itself, over the same links. The difference of the two is what the
bridge adds: its own work and one more hop. All on loopback TCP, peers with direct links, as on a robot.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.geometry.pose import to_message
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.channels import ROS_RECEIVED
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.endpoints import Endpoint, endpoints
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.rmw_zenoh import RmwZenoh
from eigenscan.schemas.channels import ODOMETRY, POSE, SCAN_RAW, TRANSFORM, Channel
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.wire import encode, encoding
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.wrappers_pb2 import BytesValue

SITE = {"site": "benchmark", "robot": "robot", "lidar": "scan"}
SETTINGS = RosBridgeOptions(site="benchmark", mounts_from_tf=False, domain=77)
WARM_UP = 50
"""Rounds that do not count: links are still being made."""
WAIT_S = 1.0
GOAL_MS = 1.0


def laser_scan(beams: int) -> bytes:
    ranges = np.random.default_rng(0).uniform(0.5, 12.0, beams).astype(np.float32)
    none = np.zeros(0, dtype=np.float32)
    return cdr.encode(
        cdr.make(cdr.LASER_SCAN, header("laser"), -3.1, 3.1, 6.2 / beams, 0.0, 0.1, 0.1, 12.0, ranges, none)
    )


def odometry() -> bytes:
    zero = cdr.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    turn = cdr.make("geometry_msgs/msg/Quaternion", 0.0, 0.0, 0.0, 1.0)
    pose = cdr.make("geometry_msgs/msg/Pose", cdr.make("geometry_msgs/msg/Point", 1.0, 2.0, 0.0), turn)
    twist = cdr.make("geometry_msgs/msg/Twist", zero, zero)
    stated = cdr.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
    moving = cdr.make("geometry_msgs/msg/TwistWithCovariance", twist, np.zeros(36))
    return cdr.encode(cdr.make(cdr.ODOMETRY, header("odom"), "base_link", stated, moving))


def header(frame: str) -> object:
    return cdr.make("std_msgs/msg/Header", cdr.make("builtin_interfaces/msg/Time", 1_700_000_000, 0), frame)


def published(channel: Channel) -> Envelope:
    """What the tracker reports."""
    if channel is POSE:
        pose = PoseEstimate(timestamp=stamp(10**18), frame_id="map", state=STATE_LOCALIZED)
        pose.pose.CopyFrom(to_message((1.0, 2.0, 0.5)))
        return Envelope(POSE, SITE, pose)
    transform = FrameTransform(timestamp=stamp(10**18), parent_frame_id="map", child_frame_id="odom")
    transform.rotation.w = 1.0
    return Envelope(TRANSFORM, SITE, transform)


class Echo:
    """Publishes bytes on one key and waits until something comes on another."""

    def __init__(self, session: zenoh.Session, ear: zenoh.Session, out: str, back: str, encoded: str) -> None:
        self._came = threading.Event()
        self._publisher = session.declare_publisher(
            out, encoding=zenoh.Encoding(encoded), express=True, priority=zenoh.Priority.REAL_TIME
        )
        self._subscriber = ear.declare_subscriber(back, lambda _sample: self._came.set())
        self.times: list[float] = []
        self.lost = 0

    def once(self, payload: bytes) -> None:
        self._came.clear()
        begin = time.perf_counter()
        self._publisher.put(payload)
        if self._came.wait(WAIT_S):
            self.times.append(1e3 * (time.perf_counter() - begin))
        else:
            self.lost += 1

    def quantiles(self) -> dict[str, float]:
        counted = np.array(self.times[WARM_UP:])
        return {"p50": float(np.quantile(counted, 0.5)), "p99": float(np.quantile(counted, 0.99))}


def measure(rate: float, seconds: float, beams: int) -> dict[str, dict[str, float]]:
    port = free_port()
    hub = {"mode": "peer", "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    leaf = {"mode": "peer", "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]}}
    leaf["listen"] = {"endpoints": ["tcp/127.0.0.1:0"]}
    alone = {"scouting": {"multicast": {"enabled": False}}}
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "leaf.json5"
        config.write_text(json.dumps(alone | leaf))
        flags = ["--site", "benchmark", "--zenoh", str(config), "--ros-router", f"tcp/127.0.0.1:{port}"]
        flags += ["--mounts-from-tf", "false", "--domain", str(SETTINGS.domain), "--log-level", "error"]
        with (
            zenoh.open(zenoh.Config.from_json5(json.dumps(alone | hub))) as session,
            zenoh.open(zenoh.Config.from_json5(json.dumps(alone | leaf))) as ear,
            subprocess.Popen([sys.executable, "-m", "eigenscan.ros_bridge.node", *flags]) as process,
        ):
            figures = run(session, ear, psutil.Process(process.pid), rate, seconds, beams)
            process.terminate()
    return figures


def run(
    session: zenoh.Session,
    ear: zenoh.Session,
    bridge: psutil.Process,
    rate: float,
    seconds: float,
    beams: int,
) -> dict[str, dict[str, float]]:
    ends, dialect = endpoints(SETTINGS), RmwZenoh(SETTINGS.domain, "", str(session.zid()))

    def key(endpoint: Endpoint | None) -> str:
        assert endpoint is not None
        return dialect.key(endpoint)

    pose, transform = published(POSE), published(TRANSFORM)
    ways: dict[str, tuple[str, str, str, bytes]] = {
        "scan": (key(ends.scans[0]), SCAN_RAW.key(SITE), "", laser_scan(beams)),
        "odom": (key(ends.odometry), ODOMETRY.key(SITE), "", odometry()),
        "amcl_pose": (pose.key, key(ends.pose), encoding(POSE), encode(pose.message)),
        "tf": (transform.key, key(ends.map_to_odom), encoding(TRANSFORM), encode(transform.message)),
    }
    through = {name: Echo(session, ear, out, back, code) for name, (out, back, code, _) in ways.items()}
    straight = {name: Echo(session, ear, f"direct/{name}", f"direct/{name}", "") for name in ways}
    wait_for_bridge(through["scan"], ways["scan"][3])
    busy = bridge.cpu_times()
    rounds = WARM_UP + int(rate * seconds)
    for number in range(rounds):
        due = time.perf_counter() + 1.0 / rate
        for name, (_, _, _, payload) in ways.items():
            # in turn, and in turn first: what disturbs one disturbs the other
            for echo in (straight, through) if number % 2 else (through, straight):
                echo[name].once(payload)
        time.sleep(max(0.0, due - time.perf_counter()))
    after = bridge.cpu_times()
    figures = {}
    for name in ways:
        direct, bridged = straight[name].quantiles(), through[name].quantiles()
        figures[name] = {
            **{f"direct_{q}_ms": value for q, value in direct.items()},
            **{f"bridged_{q}_ms": value for q, value in bridged.items()},
            **{f"added_{q}_ms": bridged[q] - direct[q] for q in direct},
            "core_us": core_us(name, ways[name][3]),
            "lost": float(through[name].lost),
        }
    spent = after.user + after.system - busy.user - busy.system
    figures["all"] = {
        "cpu_us_a_message": 1e6 * spent / (rounds * len(ways)),
        "messages": float(rounds * len(ways)),
    }
    return figures


def wait_for_bridge(echo: Echo, payload: bytes) -> None:
    while not echo.times:
        echo.once(payload)
    echo.times.clear()
    echo.lost = 0


def core_us(name: str, payload: bytes) -> float:
    """us for one message in the core alone: decoding, converting, encoding."""
    core = RosBridgeCore(SETTINGS, SETTINGS.site, SETTINGS.robot)
    received = {
        "scan": Envelope(ROS_RECEIVED, {"endpoint": "%scan"}, BytesValue(value=payload)),
        "odom": Envelope(ROS_RECEIVED, {"endpoint": "%odom"}, BytesValue(value=payload)),
        "amcl_pose": published(POSE),
        "tf": published(TRANSFORM),
    }[name]
    return best_us(lambda: [encode(each.message) for each in core.handle(received)])


def best_us(call: Callable[[], object], repeats: int = 5, count: int = 500) -> float:
    best = np.inf
    for _ in range(repeats):
        begin = time.perf_counter()
        for _ in range(count):
            call()
        best = min(best, (time.perf_counter() - begin) / count)
    return 1e6 * best


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=50.0, help="rounds a second, each with all four topics")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--beams", type=int, default=720)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    figures = measure(given.rate, given.seconds, given.beams)
    print(
        f"{'topic':12}{'direct p50/p99':>18}{'bridged p50/p99':>18}{'added p50/p99':>18}"
        f"{'core':>10}{'lost':>6}"
    )
    for name, row in figures.items():
        if name != "all":
            pairs = [
                f"{row[f'{way}_p50_ms']:.2f} / {row[f'{way}_p99_ms']:.2f} ms"
                for way in ("direct", "bridged", "added")
            ]
            columns = "".join(f"{pair:>18}" for pair in pairs)
            print(f"{name:12}{columns}{row['core_us']:7.0f} us{row['lost']:6.0f}")
    worst = max(row["added_p99_ms"] for name, row in figures.items() if name != "all")
    print(f"added, 99th percentile, worst topic: {worst:.2f} ms (goal: {GOAL_MS:g} ms)")
    print(f"CPU of the bridge: {figures['all']['cpu_us_a_message']:.0f} us a message")
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
