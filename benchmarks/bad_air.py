"""What a bad link between a robot and its site costs: packets lost, late, or for a while none at all.

    .venv/bin/python benchmarks/bad_air.py [--seconds 20] [--bursts] [--json OUT]

As root. A site and two robots, a network namespace each, as `eigenscan fleet certify` makes them. Of one
robot's link so many packets are lost, and each comes so much later. Printed: which share of its poses comes
to the site, and how late; the longest time in which the site heard none; the bytes that the link carried,
headers and repetitions included; the longest time without a claim on any robot. Then how soon the site hears
the robot again after a cut, and how soon the robot works with new models over a link of 30 kB/s that is cut
off meanwhile. --bursts: with hold_back_floods = false in fleet.toml.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # the machines are those of the tests

from tests.machines.air import Link
from tests.machines.bad_air import (
    await_version,
    cut,
    measure,
    renew_models,
    wrong_claims,
)
from tests.machines.site import Fleet, fleet

CONDITIONS = ((0.0, 0.0), (0.01, 0.02), (0.05, 0.05), (0.1, 0.05), (0.1, 0.1), (0.2, 0.1))
CUTS_S = (5.0, 15.0, 60.0)
NARROW = Link(loss=0.05, delay_s=0.05, bytes_per_s=30_000.0)
ROBOTS = ("r1", "r2")


def row_text(row: dict[str, Any]) -> str:
    return (
        f"{row['loss']:6.0%} {2 * row['delay_ms']:8.0f} ms {row['arrived']:8.1%} {row['median_ms']:7.0f} ms "
        f"{row['p99_ms']:7.0f} ms {row['longest_silence_s']:7.1f} s "
        f"{row['link_bytes_per_s'] / 1e3:6.1f} kB/s {max(row['unlocalized_s'].values()):6.1f} s"
    )


def catch_up(made: Fleet) -> dict[str, float]:
    """New models over a narrow link, cut off for 15 s after the first 2 s of them."""
    robot, link = ROBOTS[0], made.air.links[ROBOTS[0]]
    link.loss, link.delay_s, link.bytes_per_s = NARROW.loss, NARROW.delay_s, NARROW.bytes_per_s
    version = renew_models(made, 0.9)
    began, passed = time.monotonic(), link.passed_bytes
    time.sleep(2.0)
    cut(made, robot, 15.0)
    took = await_version(made, robot, version) - began
    return {"seconds": took, "bytes": link.passed_bytes - passed}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--bursts", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows, cuts = [], {}
    with (
        tempfile.TemporaryDirectory() as name,
        fleet(Path(name), ROBOTS, 7200.0, {}, Path(name) / "r", not arguments.bursts) as made,
    ):
        print(
            f"{'lost':>6} {'round trip':>11} {'arrived':>8} {'median':>10} {'p99':>10} {'silence':>9} "
            f"{'link':>11} {'unlocalized':>11}"
        )
        for loss, delay in CONDITIONS:
            link = Link(loss=loss, delay_s=delay, jitter_s=delay / 3)
            rows.append(measure(made, ROBOTS[0], link, arguments.seconds))
            print(row_text(rows[-1]), flush=True)
        for seconds in CUTS_S:
            cuts[seconds] = cut(made, ROBOTS[0], seconds)
            print(
                f"cut off for {seconds:.0f} s: heard at the site again after {cuts[seconds]:.1f} s",
                flush=True,
            )
        models = catch_up(made)
        wrong = sum(wrong_claims(made, robot) for robot in ROBOTS)
    print(
        f"new models at 30 kB/s, 5 % lost, cut off for 15 s: after {models['seconds']:.1f} s, "
        f"{models['bytes'] / 1e6:.2f} MB both ways"
    )
    print(f"wrong claims: {wrong}")
    if arguments.json:
        result = {"conditions": rows, "cuts_s": cuts, "models": models, "wrong": wrong}
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
