"""What a robot costs in bytes a second over the air, by key: real services, a simulated robot, certificates.

    .venv/bin/python benchmarks/bandwidth.py [--seconds 20] [--json OUT]

A robot's router and services, a site's router and mapbuilder, configured by `eigenscan fleet certify`. Twice:
as shipped, and with raw scans asked for at 5 Hz. Of each key what the robot's services and the site receive
(payloads); `link` is all that passes between the two routers, with TLS, without TCP's headers.
"""

import argparse
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.cli.launch.supervision import SERVICES, Supervisor
from eigenscan.fleet.configuration import INSTALLED, PORT
from eigenscan.geometry.gridmap import write_map
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import CHANNELS, find
from eigenscan.workbench.simulation.live import publish
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office

SITE, ROBOT = "hospital", "r17"
ROUTER = "eigenscan.runtime.router"
EIGENSCAN = Path(sys.executable).with_name("eigenscan")
SETTLE_S, PATIENCE_S = 10.0, 60.0
ASKED = "\n[robots.r17]\nscan_raw = 5.0\n"
CASES = {"as shipped": "", "raw scans at 5 Hz": ASKED}


class Counted:
    """A TCP connection to `target` for everyone who connects to `port`; counts the bytes each way."""

    def __init__(self, port: int, target: int) -> None:
        self.bytes: Counter[str] = Counter()
        self._server, self._target = socket.create_server(("127.0.0.1", port)), target
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            robot, _ = self._server.accept()
            site = socket.create_connection(("127.0.0.1", self._target))
            for name, source, sink in (("up", robot, site), ("down", site, robot)):
                threading.Thread(target=self._pass, args=(name, source, sink), daemon=True).start()

    def _pass(self, name: str, source: socket.socket, sink: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                self.bytes[name] += len(data)
                sink.sendall(data)
        except OSError:
            pass  # the routers end
        sink.close()


def certify(folder: Path, settings: str) -> dict[str, int]:
    """A fleet of one robot on this machine; gives the port of each router, and of the counter."""
    fleet = folder / "fleet"
    command = [
        str(EIGENSCAN),
        "fleet",
        "certify",
        "--site",
        SITE,
        "--address",
        "localhost",
        "--robot",
        ROBOT,
        "-o",
        str(fleet),
    ]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    with (fleet / "fleet.toml").open("a", encoding="utf-8") as file:
        file.write(settings)
    subprocess.run([EIGENSCAN, "fleet", "configure", "-o", fleet], check=True, stdout=subprocess.DEVNULL)
    ports = {"site": free_port(), "robot": free_port(), "air": free_port()}
    for machine in (fleet / "site", fleet / "robots" / ROBOT):
        for path in machine.glob("*.json5"):
            text = (
                path.read_text(encoding="utf-8").replace(INSTALLED, str(machine)).replace("[::]", "127.0.0.1")
            )
            text = text.replace(f"tcp/127.0.0.1:{PORT}", f"tcp/127.0.0.1:{ports['robot']}")
            other = ports["air"] if machine.name == ROBOT else ports["site"]
            path.write_text(text.replace(f":{PORT}", f":{other}"), encoding="utf-8")
    return ports


def wait_for(port: int) -> None:
    """Until somebody listens."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    raise SystemExit("no router")


@contextmanager
def fleet_of_one(
    folder: Path, settings: str, stage: Stage
) -> Iterator[tuple[Counted, zenoh.Session, zenoh.Session]]:
    """All services up; gives the counter, and a session at the site and one on the robot."""
    ports = certify(folder, settings)
    site, robot = folder / "fleet/site", folder / "fleet/robots" / ROBOT
    air = Counted(ports["air"], ports["site"])
    with ExitStack() as stack:
        supervisor = stack.enter_context(Supervisor(folder / "logs"))
        at_site = ["--site", SITE, "--zenoh"]
        shared = ["--site", SITE, "--robot", ROBOT, "--zenoh"]
        write_map(stage.grid, folder / "map.yaml")
        supervisor.start("site-router", ROUTER, [*at_site, str(site / "router.json5")])
        wait_for(ports["site"])
        supervisor.start("router", ROUTER, [*shared, str(robot / "router.json5")])
        mapbuilder = [*at_site, str(site / "mapbuilder.json5"), "--map", str(folder / "map.yaml")]
        supervisor.start("mapbuilder", SERVICES["mapbuilder"], mapbuilder)
        for name in ("scan-ingest", "projector", "tracker"):
            supervisor.start(name, SERVICES[name], [*shared, str(robot / "service.json5")])
        yield (
            air,
            stack.enter_context(open_session(site / "recorder.json5")),
            stack.enter_context(open_session(robot / "service.json5")),
        )


def measure(folder: Path, settings: str, seconds: float) -> dict[str, Any]:
    """Bytes of one robot, by key."""
    stage = Stage(office().render(), Scenario(seconds=3600.0, seed=3, site=SITE, robot=ROBOT))
    received: dict[str, Counter[str]] = {"site": Counter(), "robot": Counter()}
    times: dict[str, Counter[str]] = {"site": Counter(), "robot": Counter()}
    with ExitStack() as stack:
        air, site, robot = stack.enter_context(fleet_of_one(folder, settings, stage))
        for where, session in (("site", site), ("robot", robot)):
            listen(session, received[where], times[where])
        driver = stack.enter_context(Bus(open_session(folder / "fleet/robots" / ROBOT / "service.json5")))
        stop = threading.Event()
        stage.epoch = time.time_ns()
        driving = threading.Thread(target=publish, args=(stage.messages(), driver.publish, 1.0, stop))
        driving.start()
        end = time.monotonic() + PATIENCE_S
        while not (received["robot"]["model_set"] and received["site"]["pose"]):
            if time.monotonic() > end:
                stop.set()
                driving.join()
                raise SystemExit("no pose came to the site")
            time.sleep(0.1)
        time.sleep(SETTLE_S)
        models = sum(received["robot"][name] for name in ("map", "model", "model_set"))
        begin = (
            dict(air.bytes),
            {where: (Counter(received[where]), Counter(times[where])) for where in received},
        )
        began = time.monotonic()
        time.sleep(seconds)
        took = time.monotonic() - began
        link = {way: (air.bytes[way] - begin[0][way]) / took for way in ("up", "down")}
        rows = {}
        for name in sorted(received["robot"] | received["site"]):
            rows[name] = {
                f"{where}_{unit}": (now[where][name] - begin[1][where][index][name]) / took
                for index, (unit, now) in enumerate((("bytes_s", received), ("hz", times)))
                for where in ("robot", "site")
            }
        stop.set()
        driving.join()
    return {"keys": rows, "link_bytes_s": link, "models_bytes": models}


def listen(session: zenoh.Session, received: Counter[str], times: Counter[str]) -> None:
    """Counts what is received of the robot, and of maps and models, by channel."""

    def on_sample(sample: Any) -> None:
        found = find(str(sample.key_expr))
        if found and found[1].get("instance", ROBOT) == ROBOT:
            received[found[0].name] += len(sample.payload)
            times[found[0].name] += 1

    for channel in CHANNELS:
        session.declare_subscriber(channel.selector({"site": SITE}), on_sample)
        if channel.qos.latched:
            session.get(channel.selector({"site": SITE}), lambda _: None)


def show(case: str, result: dict[str, Any]) -> None:
    print(f"\n{case}\n{'key':14} {'on the robot':>22} {'at the site':>22}")
    for name, row in result["keys"].items():
        if row["robot_hz"]:
            there = f"{row['robot_hz']:6.1f} Hz {row['robot_bytes_s']:9.0f} B/s"
            site = f"{row['site_hz']:6.1f} Hz {row['site_bytes_s']:9.0f} B/s" if row["site_hz"] else "stays"
            print(f"{name:14} {there:>22} {site:>22}")
    link = result["link_bytes_s"]
    print(f"{'link':14} {'':22} {link['up']:14.0f} B/s up, {link['down']:.0f} B/s down")
    print(f"maps and models, once: {result['models_bytes'] / 1e6:.2f} MB")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    results = {}
    for case, settings in CASES.items():
        with tempfile.TemporaryDirectory() as folder:
            results[case] = measure(Path(folder), settings, arguments.seconds)
        show(case, results[case])
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
