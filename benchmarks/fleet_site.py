"""What a site's server has to do for many robots: their real traffic over TLS, the shipped configuration.

    .venv/bin/python benchmarks/fleet_site.py [--robots 10,50,100,200] [--seconds 20] [--no-viewer]
                                              [--json OUT]

A robot's poses (10 Hz), tracks (1 Hz) and the healths of its four services (1 Hz each), as projector and
tracker say them on a simulated drive, are said by each robot with its own certificate over its own link. The
site is as `eigenscan fleet certify` configures it: its router with access control and limits, the recorder
with its live picture, the mapbuilder that keeps the map true, `fleet metrics`. "arrived" is the share of
poses that an operator hears, "held back" the share that the router's limit against floods takes, because
this benchmark was late and said two at once; "in the file" is the share that the recorder wrote, "nowhere"
that which neither has: it was lost before the site's router or by it, what only one lacks on the way from it.
Latency is from a pose's stamp to the operator; "dropped" and "lost" are the recorder's own counters; bytes
are payloads and keys.
"""

import argparse
import heapq
import json
import multiprocessing
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.eigenspace.folder import read_models
from eigenscan.fleet.configuration import FLOOD, INSTALLED, PORT
from eigenscan.geometry.gridmap import to_message, write_map
from eigenscan.mapbuilder.core import announce_models
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.loopback import Loopback
from eigenscan.runtime.recording import parts
from eigenscan.runtime.recording.files import messages, opened
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import HEALTH, MAP, POSE, TRACKS, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode, encoding
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from fleet_robots import canonical

from fleet import PROGRAM

SITE = "scale"
DRIVE_S, SETTLE_S, PERIOD_NS = 30.0, 8.0, 100_000_000
ON_ROBOT = ("router", "scan-ingest", "projector", "tracker")
Line = tuple[int, Channel, dict[str, str], bytes]
"""When in the drive, ns; what; where; its bytes."""


def drive(folder: Path) -> list[Line]:
    """What one robot sends to the site, in order of time."""
    stage = Stage(office().render(), Scenario(seconds=DRIVE_S, seed=3, people=2, site=SITE))
    write_map(stage.grid, folder / "map.yaml")
    subprocess.run(
        [PROGRAM, "build", folder / "map.yaml", "-o", folder / "model"], check=True, stdout=subprocess.DEVNULL
    )
    models, address = read_models(folder / "model"), {"site": SITE, "robot": "r", "lidar": "front"}
    projector, tracker = ProjectorCore(ProjectorSettings()), TrackerCore(TrackerSettings())
    for model in [
        Envelope(MAP, {"site": SITE}, to_message(models.grid, models.frame_id)),
        *announce_models(models, SITE),
    ]:
        projector.handle(model)
    pipeline, lines, tracks, health = Loopback([projector, tracker]), list[Line](), 0, 0
    said = canonical(stage, 10.0)
    for at, envelope in said:
        envelope.message.timestamp.CopyFrom(stamp(at))  # type: ignore[attr-defined]
        for one in pipeline.hear(Envelope(envelope.channel, address, envelope.message)):
            due = at - said[0][0]
            if one.channel is POSE or (one.channel is TRACKS and due >= tracks):
                lines.append((due, one.channel, {}, encode(one.message)))
                tracks = due + 10 * PERIOD_NS if one.channel is TRACKS else tracks
        if at - said[0][0] >= health:
            health += 10 * PERIOD_NS
            for service in ON_ROBOT:
                core = projector if service == "projector" else tracker
                monitor = Monitor(service, "r-000", "0.1.0", settings=TrackerSettings(robot="r-000").told())
                monitor.turn(core.condition())
                lines.append((at - said[0][0], HEALTH, {"service": service}, encode(monitor.message())))
    return lines


def generate(
    configs: list[tuple[str, str]],
    lines: list[Line],
    ready: Event,
    stop: Event,
    window: Any,
    poses: Any,
) -> None:
    """Says what the robots of `configs` (name, configuration) say, until told to stop.

    `poses`: said so far with stamps (ns) within `window`; and of them those that the site's router holds
    back, for they come sooner after the robot's last one than it lets through: this process was late before.
    """
    least_s = 1.0 / (POSE.qos.air_hz * FLOOD)
    passed: dict[str, float] = {}
    sessions = {name: zenoh.open(zenoh.Config.from_json5(text)) for name, text in configs}
    publishers: dict[str, zenoh.Publisher] = {}
    began, wall = time.monotonic(), time.time_ns()
    due = [(number * 1.0 / len(configs), number, 0) for number in range(len(configs))]
    heapq.heapify(due)
    ready.set()
    while not stop.is_set():
        at, number, index = due[0]
        if (wait := began + at - time.monotonic()) > 0:
            time.sleep(wait)
        name, (when, channel, where, payload) = configs[number][0], lines[index]
        message = channel.message.FromString(payload)
        moment = wall + int((time.monotonic() - began) * 1e9)
        message.timestamp.CopyFrom(stamp(moment))  # type: ignore[attr-defined]
        key = channel.key({"site": SITE, "robot": name, "instance": name, **where})
        if key not in publishers:
            publishers[key] = sessions[name].declare_publisher(
                key, encoding=zenoh.Encoding(encoding(channel)), express=channel.qos.express,
                priority=getattr(zenoh.Priority, channel.qos.priority.name),
            )  # fmt: skip
        publishers[key].put(encode(message))
        if channel == POSE:  # a copy, in this process
            held = time.monotonic() - passed.get(key, 0.0) < least_s
            if window[0] <= moment < window[1]:
                poses[0] += 1
                poses[1] += held
            if not held:
                passed[key] = time.monotonic()
        later = lines[(index + 1) % len(lines)][0] - when
        heapq.heapreplace(
            due, (at + max(later, PERIOD_NS * (later < 0)) * 1e-9, number, (index + 1) % len(lines))
        )
    for session in sessions.values():
        session.close()


def recorded_poses(folder: Path, begin: int, end: int) -> set[tuple[str, int]]:
    """Key and stamp of each pose in the recorder's files with a stamp from `begin` to before `end`, ns."""
    found = set()
    for path in parts(folder):
        with opened(path) as file:
            for _, channel, message in messages(file):
                if POSE.parse(channel.topic) and begin <= message.publish_time < end:
                    found.add((channel.topic, message.publish_time))
    return found


@dataclass
class Ear:
    """What an operator hears within a window."""

    waits: dict[tuple[str, int], float] = field(default_factory=dict)
    """Of a pose by key and stamp, ns: ms."""
    robots: set[str] = field(default_factory=set)
    bytes: int = 0
    recorder: dict[str, int] = field(default_factory=dict)

    def on_sample(self, sample: zenoh.Sample) -> None:
        now, key = time.time_ns(), str(sample.key_expr)
        self.bytes += len(sample.payload) + len(key)
        if POSE.parse(key):
            pose = PoseEstimate.FromString(sample.payload.to_bytes())
            self.waits[key, nanoseconds(pose.timestamp)] = (now - nanoseconds(pose.timestamp)) * 1e-6
            self.robots.add(key)
        elif "/health/recorder/" in key:
            self.recorder = dict(Health.FromString(sample.payload.to_bytes()).counters)


def installed(folder: Path, name: str, port: int, **changes: Any) -> str:
    """A configuration of the fleet's folder as it is on this machine."""
    text = (folder / name).read_text().replace(INSTALLED, str((folder / name).parent))
    found = json.loads(text.replace("[::]", "127.0.0.1").replace(f":{PORT}", f":{port}"))
    return json.dumps(found | changes)


def configure(folder: Path, names: list[str], port: int) -> dict[str, Path]:
    """Certificates and configuration of the site and its robots; the site's files by name."""
    robots = [word for name in names for word in ("--robot", name)]
    command = ["fleet", "certify", "--site", SITE, "--address", "localhost", *robots, "-o", str(folder)]
    subprocess.run([PROGRAM, *command], check=True, stdout=subprocess.DEVNULL)
    found = {}
    for name in ("site/router", "site/recorder", "site/mapbuilder", "operator/operator"):
        found[name.rpartition("/")[2]] = path = folder / f"{name}.here.json5"
        path.write_text(installed(folder, f"{name}.json5", port))
    return found


def measure(
    lines: list[Line], configs: list[tuple[str, str]], operator: Path, seconds: float,
    processes: dict[str, psutil.Process], recordings: Path,
) -> dict[str, Any]:  # fmt: skip
    """One row of the table."""
    spawn = multiprocessing.get_context("spawn")
    ready, stop = spawn.Event(), spawn.Event()
    window, poses = spawn.Array("q", 2, lock=False), spawn.Array("q", 2, lock=False)
    robots = spawn.Process(target=generate, args=(configs, lines, ready, stop, window, poses), daemon=True)
    robots.start()
    ready.wait(300.0)
    ear = Ear()
    with open_session(operator) as session:
        session.declare_subscriber(f"{SITE}/**", ear.on_sample)
        time.sleep(SETTLE_S)
        used = {name: sum(one.cpu_times()[:2]) for name, one in processes.items()}
        before, ear.bytes, began = dict(ear.recorder), 0, time.time_ns()
        window[1] = began + int(seconds * 1e9)
        window[0] = began
        time.sleep(seconds)
        passed, heard = (time.time_ns() - began) * 1e-9, ear.bytes
        cores = {n: (sum(one.cpu_times()[:2]) - used[n]) / passed for n, one in processes.items()}
        time.sleep(1.5)
        after = dict(ear.recorder)
        stop.set()
        robots.join(60.0)
        deadline = time.monotonic() + 60.0
        ear.recorder = {}
        while ear.recorder.get("waiting", 1) and time.monotonic() < deadline:
            time.sleep(0.1)
        time.sleep(1.0)  # what it has taken is in the file
    said, held = poses
    waits = {pose: ms for pose, ms in ear.waits.items() if window[0] <= pose[1] < window[1]}
    written = recorded_poses(recordings, window[0], window[1])
    ms = np.array(list(waits.values()) or [np.nan])

    def grew(*names: str) -> int:
        return sum(after.get(name, 0) - before.get(name, 0) for name in after if name.startswith(names))

    return {
        "robots": len(configs), "heard_of": len(ear.robots), "load": psutil.getloadavg()[0],
        "poses_per_s": said / passed, "arrived": len(waits) / said, "held_back": held / said,
        "in_file": len(written) / said, "nowhere": 1.0 - len(written | waits.keys()) / said,
        "p50_ms": float(np.median(ms)), "p99_ms": float(np.quantile(ms, 0.99)),
        "kb_per_s": heard / passed / 1e3, "cores": cores,
        "rss_mb": {n: one.memory_info().rss / 1e6 for n, one in processes.items()},
        "dropped": grew("dropped_"), "lost": grew("mcap_lost"), "recorded": grew("heard_"),
    }  # fmt: skip


def show(row: dict[str, Any]) -> None:
    cores = " ".join(f"{row['cores'][name]:5.2f} {row['rss_mb'][name]:5.0f}" for name in row["cores"])
    print(
        f"{row['robots']:6} {row['poses_per_s']:7.0f} {row['arrived']:8.1%} {row['in_file']:11.1%} "
        f"{row['nowhere']:7.1%} {row['held_back']:9.1%} "
        f"{row['p50_ms']:7.1f} {row['p99_ms']:7.1f} {row['kb_per_s']:7.0f} | {cores} | "
        f"{row['recorded']:8} {row['dropped']:7} {row['lost']:5} | {row['load']:5.1f}",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", default="10,50,100,200")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--no-viewer", action="store_true", help="the recorder without its live picture")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    counts = [int(count) for count in options.robots.split(",")]
    names = [f"r-{number:03d}" for number in range(max(counts))]
    rows: list[dict[str, Any]] = []
    with ExitStack() as stack:
        folder, port = Path(stack.enter_context(tempfile.TemporaryDirectory())), free_port()
        lines, fleet = drive(folder), folder / "fleet"
        files = configure(fleet, names, port)
        supervisor = stack.enter_context(Supervisor(folder / "logs"))
        viewer = [] if options.no_viewer else ["--viewer-port", "0", "--data-port", "0"]
        own = {
            "recorder": ["--mcap", str(folder / "recordings"), "--budget-mb", "20000", *viewer],
            "mapbuilder": ["--model", str(folder / "model")],
        }
        supervisor.start(
            "router", "eigenscan.runtime.router", ["--site", SITE, "--zenoh", str(files["router"])]
        )
        for service, flags in own.items():
            shared = ["--site", SITE, "--zenoh", str(files[service]), "--instance", "site"]
            supervisor.start(service, SERVICES[service], [*shared, *flags])
        command = [PROGRAM, "fleet", "metrics", "--site", SITE, "--zenoh", files["operator"], "--port", "0"]
        time.sleep(3.0)  # a person's command does not wait for a router that starts
        metrics = subprocess.Popen([*map(str, command)], stdout=subprocess.DEVNULL)
        stack.callback(metrics.wait)
        stack.callback(metrics.terminate)
        processes = {name: psutil.Process(one.process.pid) for name, one in supervisor.children.items()}
        processes["metrics"] = psutil.Process(metrics.pid)
        configs = [
            (
                name,
                installed(
                    fleet, f"robots/{name}/router.json5", port, mode="client", listen={"endpoints": []},
                    access_control={"enabled": False}, downsampling=[], qos={},
                ),
            )
            for name in names
        ]  # fmt: skip
        head = " ".join(f"{name:>11}" for name in processes)
        print(
            f"{'robots':>6} {'poses/s':>7} {'arrived':>8} {'in the file':>11} {'nowhere':>7} "
            f"{'held back':>9} {'p50 ms':>7} {'p99 ms':>7} "
            f"{'kB/s':>7} | {head} (cores, MB) | {'recorded':>8} {'dropped':>7} {'lost':>5} | {'load':>5}"
        )
        for count in counts:
            rows.append(
                measure(
                    lines,
                    configs[:count],
                    files["operator"],
                    options.seconds,
                    processes,
                    folder / "recordings",
                )
            )
            show(rows[-1])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.exit(0 if all(row["heard_of"] == row["robots"] for row in rows) else 1)


if __name__ == "__main__":
    main()
