"""What a localized robot costs: processor time and memory of each process, and how long a pose takes.

    .venv/bin/python benchmarks/light.py [--rates 10 40] [--turns 2] [--against CHECKOUT] [--json OUT]

A simulated robot in the demo's building drives in real time; all services of `eigenscan run` work for it, the
recorder writes. Ways by turns in one run, so that they meet the same machine: each service a process of its
own (`separate`), all in one process (`together`), and, with --against, the same of another checkout with an
environment of its own (`-separate`, `-together`). One turn before all others does not count: in it numba
compiles what it then keeps. A row is the median over the turns: CPU ms a scan of each process, resident MB,
and ms from a raw scan's publication to its pose's arrival. AMCL's figures are of the filter alone and were
measured elsewhere (Xeon): compare ratios of this table, not these with those. Wants a quiet machine: where
others compute too, five processes get five turns for the one of `together`.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import psutil
import zenoh
from eigenscan.cli.launch.network import open_hub
from eigenscan.cli.launch.services import Pipeline
from eigenscan.cli.launch.supervision import Supervisor
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.runtime.bus import Bus
from eigenscan.schemas.channels import ODOMETRY, POSE, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.playback.cast import shifted
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage, Timed
from eigenscan.workbench.simulation.world import office

SITE, ROBOT = "light", "robot"
PROGRAM = Path(sys.executable).with_name("eigenscan")
AMCL = {"Beluga AMCL": (0.5, 0.7), "Nav2 AMCL": (2.0, 3.5)}
"""ms a scan, least and most, for a localized robot; measured elsewhere."""
SETTLE_S = 5.0
"""Localized and warm: from the first claim on."""
COMPILING_S = 20.0
"""From the first claim on, until the mapbuilder has compiled too: its first views count after 35."""
COMPILING_TURNS = 4
"""On a busy machine a drive may end before the projector has compiled."""
PATIENCE_S = 120.0
RIGHT_M = 0.5
OTHERS = "-"
"""Marks the ways of the other checkout."""


class Robot:
    """Publishes what was simulated, with stamps of now, and receives its poses."""

    def __init__(self, session: zenoh.Session, stage: Stage, messages: list[Timed]) -> None:
        self._stage, self._messages = stage, messages
        self._sent: dict[int, tuple[float, int]] = {}
        self._bus, self._stop = Bus(session), threading.Event()
        self.waits: list[tuple[float, float]] = []
        """When a scan was published, s, and how long its pose took."""
        self.localized = threading.Event()
        self.wrong = self.claims = 0
        self._ear = session.declare_subscriber(POSE.key({"site": SITE, "robot": ROBOT}), self._on_pose)
        self._driving = threading.Thread(target=self._drive)

    def __enter__(self) -> "Robot":
        self._driving.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._driving.join()
        self._ear.undeclare()

    def _drive(self) -> None:
        wall, first = time.time_ns(), self._messages[0].time

        def send(envelope: Envelope) -> None:
            at = envelope.stamp
            now = wall + at - first
            if envelope.channel is SCAN_RAW:
                self._sent[now] = time.monotonic(), at
            self._bus.publish(shifted(envelope, wall - first))

        publish(self._messages, send, 1.0, self._stop)

    def _on_pose(self, sample: zenoh.Sample) -> None:
        now = time.monotonic()
        pose = PoseEstimate.FromString(sample.payload.to_bytes())
        sent = self._sent.pop(nanoseconds(pose.timestamp), None)
        if sent is None:
            return
        self.waits.append((sent[0], now - sent[0]))
        if pose.state == STATE_LOCALIZED:
            x, y, _ = self._stage.pose_at(sent[1])
            self.claims += 1
            self.wrong += bool(np.hypot(pose.pose.x - x, pose.pose.y - y) > RIGHT_M)
            self.localized.set()


@contextmanager
def services(
    folder: Path, config: Path, way: str, against: Path | None
) -> Iterator[dict[str, psutil.Process]]:
    """The processes of one way, by name."""
    recordings = folder / f"{way}-{time.monotonic_ns()}"
    pipeline = Pipeline(
        SITE, ROBOT, ["--model", str(folder / "model")], config, recordings, None, viewer=False,
        together=way.endswith("together"),
    )  # fmt: skip
    python = str(against / ".venv/bin/python") if against and way.startswith(OTHERS) else sys.executable
    with Supervisor(folder / "logs") as supervisor, mock.patch.object(sys, "executable", python):
        pipeline.start(supervisor)
        yield {name: psutil.Process(child.process.pid) for name, child in supervisor.children.items()}


def compile_all(
    session: zenoh.Session,
    folder: Path,
    config: Path,
    stage: Stage,
    messages: list[Timed],
    way: str = "separate",
    against: Path | None = None,
) -> None:
    """Turns that do not count: compiling costs minutes, and a process that did it stays twice as large."""
    for _ in range(COMPILING_TURNS):
        with services(folder, config, way, against), Robot(session, stage, messages) as robot:
            if robot.localized.wait(PATIENCE_S):
                time.sleep(COMPILING_S)
                return
    raise SystemExit("the robot was not localized")


def used(processes: dict[str, psutil.Process]) -> dict[str, float]:
    return {name: sum(process.cpu_times()[:2]) for name, process in processes.items()}


def measure(robot: Robot, processes: dict[str, psutil.Process], seconds: float) -> dict[str, Any]:
    if not robot.localized.wait(PATIENCE_S):
        raise SystemExit("the robot was not localized")
    time.sleep(SETTLE_S)
    began, before = time.monotonic(), used(processes)
    time.sleep(seconds)
    end, after = time.monotonic(), used(processes)
    time.sleep(0.5)  # poses that are under way
    waits = [wait for at, wait in robot.waits if began <= at < end]
    spent = {name: (after[name] - before[name]) / max(len(waits), 1) * 1e3 for name in processes}
    rss = {name: process.memory_info().rss / 1e6 for name, process in processes.items()}
    return {
        "ms_per_scan": spent | {"all": sum(spent.values())},
        "mb": rss | {"all": sum(rss.values())},
        "p50_ms": float(np.median(waits)) * 1e3,
        "p99_ms": float(np.quantile(waits, 0.99)) * 1e3,
        "scans": len(waits),
        "wrong": robot.wrong / max(robot.claims, 1),
        "load": psutil.getloadavg()[0],
    }


def median(rows: list[Any]) -> Any:
    """Of numbers, or of dicts of them, entry by entry."""
    if isinstance(rows[0], dict):
        return {name: median([row[name] for row in rows]) for name in rows[0]}
    return statistics.median(rows)


def text(rate: float, way: str, row: dict[str, Any]) -> str:
    parts = ", ".join(f"{name} {ms:.1f}" for name, ms in row["ms_per_scan"].items() if name != "all")
    sizes = ", ".join(f"{mb:.0f}" for name, mb in row["mb"].items() if name != "all")
    return (
        f"{rate:4.0f} {way:10} {row['ms_per_scan']['all']:10.2f} {row['mb']['all']:6.0f} "
        f"{row['p50_ms']:7.1f} {row['p99_ms']:7.1f} {row['wrong']:6.1%} {row['load']:5.1f}   "
        f"{parts}; MB {sizes}"
    )


def build_office(folder: Path) -> GridMap:
    """The demo's building; its map and models are written to the folder."""
    grid = office().render()
    write_map(grid, folder / "map.yaml")
    build = [str(part) for part in (PROGRAM, "build", folder / "map.yaml", "-o", folder / "model")]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    return grid


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rates", type=float, nargs="+", default=[10.0, 40.0], help="Hz of the lidar")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=15.0, help="measured in each turn")
    parser.add_argument(
        "--ways", nargs="+", choices=["separate", "together"], default=["separate", "together"]
    )
    parser.add_argument("--against", type=Path, help="another checkout, whose processes take turns")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    others = [OTHERS + way for way in given.ways] if given.against else []
    ways = [*others, *given.ways]
    rows = []
    print(
        f"{'Hz':>4} {'way':10} {'ms a scan':>10} {'MB':>6} {'p50 ms':>7} {'p99 ms':>7} {'wrong':>6} "
        f"{'load':>5}"
    )
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        grid = build_office(folder)
        session, config = open_hub(folder)
        for rate in given.rates:
            length = 60.0 + SETTLE_S + given.seconds
            lidar = Lidar(rate=rate)
            stage = Stage(grid, Scenario(seconds=length, seed=3, site=SITE, robot=ROBOT, lidar=lidar))
            messages = [one for one in stage.messages() if one.envelope.channel in (SCAN_RAW, ODOMETRY)]
            if rate == given.rates[0]:
                for mark in (OTHERS, "") if given.against else ("",):
                    compile_all(session, folder, config, stage, messages, mark + "separate", given.against)
            turns: dict[str, list[dict[str, Any]]] = {way: [] for way in ways}
            for _ in range(given.turns):
                for way in ways:
                    with (
                        services(folder, config, way, given.against) as processes,
                        Robot(session, stage, messages) as robot,
                    ):
                        turns[way].append(measure(robot, processes, given.seconds))
            for way in ways:
                rows.append({"hz": rate, "way": way, **median(turns[way])})
                print(text(rate, way, rows[-1]), flush=True)
        session.close()
    for name, (least, most) in AMCL.items():
        print(f"{'':4} {name}: {least} to {most} ms a scan, the filter alone, measured elsewhere")
    for rate in given.rates:
        of = {row["way"]: row["ms_per_scan"]["all"] for row in rows if row["hz"] == rate}
        for way in given.ways:
            than = OTHERS + way if given.against else ways[0]
            if way != than:
                print(f"at {rate:.0f} Hz, {way} is {of[than] / of[way]:.2f} times cheaper than {than}")
    if given.json:
        amcl = {name: {"least_ms": a, "most_ms": b, "measured": "elsewhere"} for name, (a, b) in AMCL.items()}
        given.json.write_text(json.dumps({"light": rows, "amcl": amcl}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
