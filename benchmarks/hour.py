"""A scripted hour: what robots miss while all sorts of things happen to a site, one after the other.

    .venv/bin/python benchmarks/hour.py [--robots 2] [--rounds 1] [--cut 15] [--full 5] [--json OUT]

As root. The site and each robot are a network namespace, with the services and the configuration that
`eigenscan fleet certify` gives them; the first robot's clock is a minute behind. Every service is restarted,
killed with -9 and started at once; the recorder's disk is full for a while, and the site out of reach.
An hour: --rounds 8 --cut 120 --full 60 --pause 10.

Printed for each event: until what was taken works again by its own word; the longest time without a claim
of the robots that it was taken from, and of the others; what of it is not explained by the first figure; and
poses said meanwhile that are not in the site's recording.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # the machines are those of the tests

from tests.machines.hour import hour, play


def show(result: dict[str, Any]) -> None:
    print(f"{'event':32} {'away':>7} {'unlocalized':>12} {'others':>7} {'beyond':>7} {'lost':>5}")
    for event in result["events"]:
        gaps = event["unlocalized_s"]
        own = max((gaps[robot] for robot in event["touches"]), default=None)
        others = max((gap for robot, gap in gaps.items() if robot not in event["touches"]), default=0.0)
        print(
            f"{event['name']:32} {event['away_s']:5.1f} s {'-' if own is None else f'{own:.1f} s':>12} "
            f"{others:5.1f} s {max(event['beyond_s'].values()):5.1f} s {event['unrecorded']:5}"
        )
    wrong = sum(result["wrong"].values())
    print(f"{result['robots']} robots, {result['seconds']:.0f} s, load {result['load']:.0f} at the end")
    print(f"claims: {result['claims']}, wrong: {wrong}")
    print(
        f"poses said while router and link were there: {result['said']}; not heard at the site: "
        f"{result['undelivered']}, at most {result['longest_undelivered']} in a row; "
        f"of {result['heard_at_site']} heard there, not recorded: {result['unrecorded']}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--cut", type=float, default=15.0, help="s that the site is out of reach")
    parser.add_argument("--full", type=float, default=5.0, help="s that the recorder's disk is full")
    parser.add_argument("--pause", type=float, default=1.0, help="s between two events")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    robots = [f"r{number + 1}" for number in range(arguments.robots)]
    with (
        tempfile.TemporaryDirectory() as folder,
        hour(Path(folder), robots, 7200.0, arguments.pause) as made,
    ):
        result = play(made, arguments.cut, arguments.full, arguments.rounds, print)
    show(result)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
