"""What the messages of a localized robot cost: how many each process receives and publishes, and their steps.

    .venv/bin/python benchmarks/messages.py [--rate 10] [--seconds 15] [--ways separate together] [--json OUT]

The robot, the services and the turn that does not count are those of light.py. First, for each scan: what a
service received and published by channel, as its health has it, and the processor time and the wakes of its
process. `python` are threads of the core and of callbacks, `zenoh` the others. Then the steps of one message
in the shell, in this process, again and again: `receive` from Zenoh's sample to the core's hand, `decode`,
`count` (metrics), `encode`, `publish` to nobody. A message that comes alone meets cold caches and takes
several times as long. Linux only.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import zenoh
from eigenscan.cli.launch.network import open_hub
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.intake import Intake
from eigenscan.schemas.channels import CHANNELS, HEALTH, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode, encode, encoding
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import Scenario, Stage
from light import PATIENCE_S, ROBOT, SETTLE_S, SITE, Robot, build_office, compile_all, services

TIMES = 5_000
DIRECTIONS = {"heard": "receives", "said": "publishes"}


class Counts:
    """The newest health of each service."""

    def __init__(self, session: zenoh.Session) -> None:
        self.newest: dict[str, Health] = {}
        self._ear = session.declare_subscriber(HEALTH.selector({"site": SITE}), self._receive)

    def _receive(self, sample: zenoh.Sample) -> None:
        health = Health.FromString(sample.payload.to_bytes())
        self.newest[health.service] = health


def tasks(process: psutil.Process) -> dict[str, dict[str, float]]:
    """Of Python's threads and of Zenoh's: processor time, ms, and how often they were woken."""
    found = {kind: {"ms": 0.0, "wakes": 0.0} for kind in ("python", "zenoh")}
    for task in Path(f"/proc/{process.pid}/task").iterdir():
        kind = found["python" if (task / "comm").read_text().startswith("python") else "zenoh"]
        kind["ms"] += int((task / "schedstat").read_text().split()[0]) * 1e-6
        words = (task / "status").read_text().split()
        kind["wakes"] += int(words[words.index("voluntary_ctxt_switches:") + 1])
    return found


def measure(robot: Robot, counts: Counts, processes: dict[str, psutil.Process], seconds: float) -> Any:
    """For each scan: messages by service, and time by process."""
    if not robot.localized.wait(PATIENCE_S):
        raise SystemExit("the robot was not localized")
    time.sleep(SETTLE_S)
    before, healths, scans = (
        {n: tasks(p) for n, p in processes.items()},
        dict(counts.newest),
        len(robot.waits),
    )
    time.sleep(seconds)
    after, scans = {n: tasks(p) for n, p in processes.items()}, len(robot.waits) - scans
    messages: dict[str, dict[str, dict[str, float]]] = {}
    for service, first in healths.items():
        last = counts.newest[service]
        share = (last.timestamp.ToNanoseconds() - first.timestamp.ToNanoseconds()) * 1e-9 / seconds
        for name, count in last.counters.items():
            direction, _, channel = name.partition("_")
            each = (count - first.counters.get(name, 0)) / share / scans
            if channel and direction in DIRECTIONS and each >= 0.05:
                messages.setdefault(service, {}).setdefault(DIRECTIONS[direction], {})[channel] = each
    used = {
        name: {
            kind: {what: (value - before[name][kind][what]) / scans for what, value in of.items()}
            for kind, of in kinds.items()
        }
        for name, kinds in after.items()
    }
    return {"messages": messages, "used": used}


def pathway(session: zenoh.Session, envelope: Envelope) -> dict[str, float]:
    """us of each step of one message."""
    channel, key, payload = envelope.channel, envelope.key, encode(envelope.message)
    samples: list[zenoh.Sample] = []
    with session.declare_subscriber(key, samples.append):
        session.put(key, payload, encoding=zenoh.Encoding(encoding(channel)))
        while not samples:
            time.sleep(0.01)
    inbox, bus, monitor = Inbox(), Bus(session), Monitor("messages", "0", "")
    intake = Intake(CHANNELS, inbox)

    def receive() -> None:
        intake.on_sample(samples[0])
        inbox.take(0.0)

    def count() -> None:
        monitor.handled(channel.name, 1e-3)
        monitor.dealt_with(channel.name, envelope.stamp)

    steps: dict[str, Callable[[], object]] = {
        "receive": receive,
        "decode": lambda: decode(channel, payload, encoding(channel)),
        "count": count,
        "encode": lambda: encode(envelope.message),
        "publish": lambda: bus.publish(envelope),
    }
    return {"bytes": len(payload)} | {name: _us(step) for name, step in steps.items()}


def _us(step: Callable[[], object]) -> float:
    step()
    began = time.thread_time()
    for _ in range(TIMES):
        step()
    return (time.thread_time() - began) / TIMES * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rate", type=float, default=10.0, help="Hz of the lidar")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--ways", nargs="+", choices=["separate", "together"], default=["separate"])
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    result: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        grid = build_office(folder)
        session, config = open_hub(folder)
        counts = Counts(session)
        length, lidar = 60.0 + SETTLE_S + given.seconds, Lidar(rate=given.rate)
        stage = Stage(grid, Scenario(seconds=length, seed=3, site=SITE, robot=ROBOT, lidar=lidar))
        messages = [one for one in stage.messages() if one.envelope.channel in (SCAN_RAW, ODOMETRY)]
        compile_all(session, folder, config, stage, messages)
        for way in given.ways:
            with services(folder, config, way, None) as processes, Robot(session, stage, messages) as robot:
                result[way] = measure(robot, counts, processes, given.seconds)
        first = {one.envelope.channel.name: one.envelope for one in reversed(messages)}
        result["pathway"] = {name: pathway(session, envelope) for name, envelope in first.items()}
        session.close()
    for way in given.ways:
        print(f"{way}, a scan:")
        for service, directions in result[way]["messages"].items():
            for direction, channels in directions.items():
                text = ", ".join(f"{name} {each:.1f}" for name, each in channels.items())
                print(f"  {service:12} {direction:9} {sum(channels.values()):5.1f}: {text}")
        for process, used in result[way]["used"].items():
            text = ", ".join(
                f"{kind} {of['ms']:.2f} ms, woken {of['wakes']:.1f} times" for kind, of in used.items()
            )
            print(f"  {process:12} {text}")
    for channel, steps in result["pathway"].items():
        text = ", ".join(f"{name} {us:.1f}" for name, us in steps.items() if name != "bytes")
        print(f"us for one {channel} of {steps['bytes']:.0f} bytes: {text}")
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
