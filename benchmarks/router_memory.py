"""What a router keeps of robots that are gone, kB a robot.

    .venv/bin/python benchmarks/router_memory.py [--robots 1000] [--json OUT]

Robots come one after the other, say 100 messages on two keys of their own and hear a third, over a session of
their own that ends with them; seven sessions hear them. "own": each has a new name; "returning": twenty names
in turn; "served": besides, a service that stays says four more keys of each, as a tracker and a projector do
that serve many robots, and undeclares each publisher a hundred robots later. Growth is that of the last half.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import deque
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
import zenoh
from eigenscan.cli.launch.network import free_port
from eigenscan.runtime.session import open_session

ROUTER = "from eigenscan.runtime.router import main; main()"
HEARERS, MESSAGES, SERVED, KEPT, NAMES = 7, 50, 4, 100, 20
HEARD = ("scan/raw/*", "scan/*", "odom", "pose", "served/*")


def visit(session: zenoh.Session, name: str) -> None:
    """One robot, from its coming to its going."""
    with session:
        session.declare_subscriber(f"s/robot/{name}/pose", lambda _: None)
        for key in ("scan/raw/front", "odom"):
            publisher = session.declare_publisher(f"s/robot/{name}/{key}")
            for _ in range(MESSAGES):
                publisher.put(bytes(200))


def measure(kind: str, robots: int) -> dict[str, Any]:
    """Memory of a router of its own before, after half of the robots and after all, MB."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        endpoint = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"]}
        alone = {"scouting": {"multicast": {"enabled": False}}}
        patient = endpoint | {"timeout_ms": -1, "exit_on_failure": False}
        for mode, text in (("router", {"listen": endpoint}), ("client", {"connect": patient})):
            (folder / f"{mode}.json5").write_text(json.dumps({**alone, **text, "mode": mode}))
        command = [sys.executable, "-c", ROUTER, "--site", "s", "--zenoh", str(folder / "router.json5")]
        router = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        stack.callback(router.wait)
        stack.callback(router.terminate)
        client = folder / "client.json5"
        hearers = [stack.enter_context(open_session(client)) for _ in range(HEARERS)]
        for hearer in hearers:
            for key in HEARD:
                hearer.declare_subscriber(f"s/robot/*/{key}", lambda _: None)
        publishers: deque[zenoh.Publisher] = deque()
        memory = [psutil.Process(router.pid).memory_info().rss]
        for number in range(robots):
            name = f"r-{number % NAMES if kind == 'returning' else number}"
            visit(open_session(client), name)
            for which in range(SERVED if kind == "served" else 0):
                publishers.append(hearers[0].declare_publisher(f"s/robot/{name}/served/{which}"))
                publishers[-1].put(bytes(200))
            while len(publishers) > KEPT * SERVED:
                publishers.popleft().undeclare()
            if number + 1 in (robots // 2, robots):
                memory.append(psutil.Process(router.pid).memory_info().rss)
    return {
        "kind": kind, "robots": robots, "rss_mb": [one / 1e6 for one in memory],
        "growth_kb_per_robot": (memory[2] - memory[1]) / 1e3 / (robots - robots // 2),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", type=int, default=1000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows = []
    for kind in ("own", "returning", "served"):
        rows.append(measure(kind, options.robots))
        memory = " ".join(f"{one:6.1f}" for one in rows[-1]["rss_mb"])
        print(f"{kind:10} {memory} MB  {rows[-1]['growth_kb_per_robot']:6.1f} kB a robot", flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
