"""What crosses a bad link between a robot and its site, and when."""

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from tests.machines.air import Link
from tests.machines.site import TERM, Fleet, Received

WRONG_M, WRONG_RAD = 0.5, math.radians(10.0)
AIR_PERIOD_S = 0.16
"""Twice the contract's shortest time between poses that cross the air: what comes sooner may be held back."""
SETTLE_S = 3.0
LEAST = 60
"""Poses: of 20, one that two processes time differently would be a twentieth."""
LATE_S = 5.0
"""After a measurement, for what is still under way."""


def measure(fleet: Fleet, robot: str, link: Link, seconds: float) -> dict[str, Any]:
    """Poses of `robot` while its link is such a one; afterwards it is whole again."""
    fleet.air.links[robot] = replace(link)
    time.sleep(SETTLE_S)
    begin = time.monotonic()
    passed = fleet.air.links[robot].passed_bytes
    time.sleep(seconds)
    # on a busy machine poses come in bursts, of which one counts
    published_by = fleet.machines[robot].ear
    published_by.wait_for(
        lambda: len(_apart(published_by.poses[robot], begin)) >= LEAST, f"{LEAST} poses of {robot}"
    )
    end = time.monotonic()
    bytes_per_s = (fleet.air.links[robot].passed_bytes - passed) / (end - begin)
    time.sleep(LATE_S)
    arrivals = {received.stamp: received.at for received in fleet.site.ear.poses[robot]}
    published = [received for received in _apart(published_by.poses[robot], begin) if received.at < end]
    late = np.array(
        [arrivals[received.stamp] - received.at for received in published if received.stamp in arrivals]
    )
    ages = [at for at in sorted(arrivals.values()) if begin < at < end + LATE_S]
    fleet.air.links[robot] = Link()
    return {
        "loss": link.loss,
        "delay_ms": link.delay_s * 1e3,
        "jitter_ms": link.jitter_s * 1e3,
        "said": len(published),
        "arrived": len(late) / len(published),
        "median_ms": float(np.median(late) * 1e3),
        "p99_ms": float(np.quantile(late, 0.99) * 1e3),
        "longest_silence_s": max((b - a for a, b in pairwise(ages)), default=float("inf")),
        "link_bytes_per_s": bytes_per_s,
        "unlocalized_s": {name: longest_gap(fleet, name, begin, end) for name in fleet.robots},
        "wrong": {name: wrong_claims(fleet, name, begin) for name in fleet.robots},
    }


def _apart(poses: Sequence[Received], begin: float) -> list[Received]:
    """Those since then that the air's limit cannot hold back."""
    return [
        received
        for before, received in pairwise(poses)
        if received.at > begin and received.at - before.at > AIR_PERIOD_S
    ]


def longest_gap(fleet: Fleet, robot: str, begin: float, end: float) -> float:
    """Of claims on the robot that came one after the other, in or around that time, by their stamps, s."""
    claims = [received for received in fleet.machines[robot].ear.poses[robot] if received.is_claim]
    return max((b.stamp - a.stamp) * 1e-9 for a, b in pairwise(claims) if a.at < end and b.at > begin)


def wrong_claims(fleet: Fleet, robot: str, since: float = 0.0) -> int:
    """Claims made on the robot that are more than 0.5 m or 10 degrees from the truth."""
    stage, wrong = fleet.drivers[robot].stage, 0
    for received in fleet.machines[robot].ear.poses[robot]:
        if not received.is_claim or received.at < since:
            continue
        x, y, heading = stage.pose_at(received.stamp)
        pose = received.pose.pose
        turned = abs(math.remainder(pose.theta - heading, math.tau))
        wrong += math.hypot(pose.x - x, pose.y - y) > WRONG_M or turned > WRONG_RAD
    return wrong


def cut(fleet: Fleet, robot: str, seconds: float) -> float:
    """Nothing passes for so long; gives the seconds until the site receives the robot again."""
    fleet.air.links[robot].cut = True
    time.sleep(seconds)
    fleet.air.links[robot].cut = False
    back = time.monotonic()
    fleet.await_claims([robot], back, at_site=True)
    return time.monotonic() - back


def renew_models(fleet: Fleet, step: float) -> str:
    """The site's mapbuilder makes others, and is started again with them; gives their version."""
    settings = fleet.site.folder / "eigenscan.toml"
    head, _, tail = settings.read_text().partition("\nstep = ")
    settings.write_text(f"{head}\nstep = {step}\n{tail.partition(chr(10))[2]}")
    fleet.site.end("mapbuilder", TERM)
    since = time.monotonic()
    fleet.site.start("mapbuilder")
    fleet.site.await_word("mapbuilder", since)
    _, health = fleet.site.ear.health["mapbuilder", "site"]
    return health.detail.rpartition("version ")[2]


def await_version(fleet: Fleet, robot: str, version: str) -> float:
    """Waits until a robot works with these models; gives when, monotonic."""
    ear = fleet.machines[robot].ear
    ear.wait_for(
        lambda: ear.poses[robot][-1].pose.model_version.startswith(version), f"{robot} to work with {version}"
    )
    return next(
        received.at for received in ear.poses[robot] if received.pose.model_version.startswith(version)
    )
