"""How soon each service works again after kill -9, on a robot that drives meanwhile.

    .venv/bin/python benchmarks/restart.py [--rounds 3] [--json OUT]

Real processes over Zenoh on this machine; a killed service is started again at once. Printed for each: until
its liveliness token is back, until it answers, and until the pose is claimed as localized again (medians over
the rounds). What a start costs is mostly Python's imports, on one core: a busy machine takes longer.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eigenscan.cli.launch.network import open_hub
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import ALIVE_TEMPLATE, HYPOTHESES, MODEL_SET, POSE, SCAN, Channel
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

SITE, ROBOT = "restart", "robot"
ANSWERS = {"scan-ingest": SCAN, "projector": HYPOTHESES, "tracker": POSE, "mapbuilder": MODEL_SET}
"""The channel on which each service shows that it works."""
PATIENCE_S = 120.0
SETTLE_S = 3.0


@dataclass
class Site:
    """What is received, and the processes."""

    supervisor: Supervisor
    flags: dict[str, list[str]]
    inbox: Inbox
    alive: set[str]

    def until(self, holds: Callable[[Channel, bytes], bool]) -> float:
        """Seconds until a sample `holds`."""
        began = time.monotonic()
        while time.monotonic() - began < PATIENCE_S:
            arrival = self.inbox.take(0.1)
            if arrival and holds(arrival.channel, arrival.payload):
                return time.monotonic() - began
        raise SystemExit("waited in vain")

    def until_localized(self) -> float:
        """Seconds until a pose is claimed."""
        return self.until(lambda channel, payload: channel is POSE and is_claim(payload))

    def kill_and_start(self, service: str) -> dict[str, float]:
        """Seconds from kill -9 to each step of the service's return."""
        killed = self.supervisor.children.pop(service).process
        killed.kill()
        killed.wait()
        while service in self.alive:
            time.sleep(0.001)
        while self.inbox.take(0.0):
            pass
        began = time.monotonic()
        self.supervisor.start(service, SERVICES[service], self.flags[service])
        tokens: list[float] = []
        watch = threading.Thread(target=lambda: tokens.append(self._token(service) - began))
        watch.start()
        answered = self.until(lambda channel, _: channel is ANSWERS[service])
        localized = answered + self.until_localized()
        watch.join()
        return {"token_s": tokens[0], "answer_s": answered, "localized_s": localized}

    def _token(self, service: str) -> float:
        while service not in self.alive:
            time.sleep(0.001)
        return time.monotonic()


def is_claim(payload: bytes) -> bool:
    return PoseEstimate.FromString(payload).state == STATE_LOCALIZED


def measure(folder: Path, rounds: int) -> dict[str, dict[str, float]]:
    stage = Stage(office().render(), Scenario(seconds=3600.0, seed=3, site=SITE, robot=ROBOT))
    write_map(stage.grid, folder / "map.yaml")
    subprocess.run(
        [Path(sys.executable).with_name("eigenscan"), "build", folder / "map.yaml", "-o", folder / "model"],
        check=True,
    )
    session, config = open_hub(folder)
    alive: set[str] = set()

    def on_token(token: object) -> None:
        service = str(token.key_expr).split("/")[2]  # type: ignore[attr-defined]
        (alive.add if "PUT" in str(token.kind) else alive.discard)(service)  # type: ignore[attr-defined]

    everyone = ALIVE_TEMPLATE.format(site=SITE, service="*", instance="*", contract="*")
    tokens = session.liveliness().declare_subscriber(everyone, on_token, history=True)
    bus, stop = Bus(session), threading.Event()
    shared = ["--site", SITE, "--robot", ROBOT, "--zenoh", str(config)]
    flags = {name: list(shared) for name in ANSWERS}
    flags["mapbuilder"] += ["--model", str(folder / "model")]
    stage.epoch = time.time_ns()
    driving = threading.Thread(target=publish, args=(stage.messages(), bus.publish, 1.0, stop))
    with bus, Supervisor(folder / "logs") as supervisor:
        site = Site(supervisor, flags, Inbox(), alive)
        bus.listen([SCAN, HYPOTHESES, POSE, MODEL_SET], {"site": SITE}, site.inbox)
        for name, given in flags.items():
            supervisor.start(name, SERVICES[name], given)
        driving.start()
        site.until_localized()
        results = {}
        for name in flags:
            runs = []
            for _ in range(rounds):
                time.sleep(SETTLE_S)
                runs.append(site.kill_and_start(name))
            results[name] = {step: statistics.median(run[step] for run in runs) for step in runs[0]}
        stop.set()
        driving.join()
        tokens.undeclare()
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results = measure(Path(folder), arguments.rounds)
    print(f"{'after kill -9, s':16} {'token':>7} {'answer':>7} {'localized':>9}")
    for name, row in results.items():
        print(f"{name:16} {row['token_s']:7.2f} {row['answer_s']:7.2f} {row['localized_s']:9.2f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
