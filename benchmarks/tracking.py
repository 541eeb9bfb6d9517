"""Figure 9 of the paper, and what a scan costs the tracker.

    python benchmarks/tracking.py --picture figure9.png --json tracking.json

A square room gives four hypotheses a scan, turned by quarter turns about its centre; a niche that is seen
better and better on the way from low-left to upper-right tells them apart.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import compose, covariance_to_message, to_message, to_pose3
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.tracking_pb2 import Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

ROOM_M = 8.0
SHOWN = (3, 5, 15, 26)
STEP_M = 0.3
ROBOT = {"site": "figure", "robot": "r"}
SIGMA = np.array([0.06, 0.06, 0.02])


def quarter_turns(pose: np.ndarray) -> np.ndarray:
    """The pose (3,) and its three images in the square room, (4, 3)."""
    centre = np.array([ROOM_M / 2, ROOM_M / 2, 0.0])
    turns = np.array([[0.0, 0.0, k * np.pi / 2] for k in range(4)])
    return compose(centre, compose(turns, pose - centre))


def heard(time_s: float, poses: np.ndarray, fits: np.ndarray, area: float = ROOM_M**2) -> Envelope:
    """A projector's answer."""
    message = Hypotheses(
        timestamp=stamp(round(time_s * 1e9)),
        frame_id="map",
        status=Hypotheses.STATUS_OK,
        searched_area_m2=area,
        hypotheses=[
            Hypothesis(
                pose=to_message(pose),
                covariance=covariance_to_message(np.diag(SIGMA**2)),
                log_likelihood=float(fit),
            )
            for pose, fit in zip(poses, fits, strict=True)
        ],
    )
    return Envelope(HYPOTHESES, {**ROBOT, "lidar": "front", "projector": "0"}, message)


def odometry(time_s: float, pose: np.ndarray) -> Envelope:
    """The robot's own dead reckoning."""
    message = Odometry(timestamp=stamp(round(time_s * 1e9)), frame_id="odom", pose=to_pose3(pose))
    return Envelope(ODOMETRY, ROBOT, message)


def figure_9(method: str = "mixture", seed: int = 9) -> Iterator[tuple[int, np.ndarray, Tracks]]:
    """Observation number, true pose and tracks after each of 26 observations."""
    rng = np.random.default_rng(seed)
    core = TrackerCore(TrackerSettings.model_validate({"method": method}))
    truth, driven = np.array([1.0, 1.0, np.pi / 4]), np.zeros(3)
    for number in range(1, max(SHOWN) + 1):
        poses = quarter_turns(truth) + rng.normal(size=(4, 3)) * SIGMA / 2
        # the niche is far at first: its few beams hardly tell; near, they do
        seen = 4.0 * (number / max(SHOWN)) ** 2
        fits = 18.0 + 0.4 * rng.normal(size=4) - seen * np.array([0.0, 1.0, 1.0, 1.0])
        list(core.handle(odometry(float(number), driven)))
        for said in core.handle(heard(float(number), poses, fits)):
            if said.channel is TRACKS:
                yield number, truth, said.open(Tracks)
        step = np.array([STEP_M, 0.0, 0.0])
        truth, driven = compose(truth, step), compose(driven, step)


def cost(hypotheses: int = 200, scans: int = 300) -> dict[str, float]:
    """Process time, ms, of a scan with its odometry while one robot is tracked."""
    rng = np.random.default_rng(0)
    core = TrackerCore(TrackerSettings())
    truth, spent = np.array([2.0, 3.0, 0.0]), []
    for scan in range(scans):
        truth = compose(truth, np.array([0.02, 0.0, 0.01]))
        others = rng.uniform([0, 0, -3], [20, 20, 3], (hypotheses - 1, 3))
        fits = np.append(25.0, rng.normal(5.0, 3.0, hypotheses - 1))
        messages = [
            odometry(0.025 * scan, truth),
            heard(0.025 * scan, np.vstack([truth, others]), fits, area=400.0),
        ]
        before = time.process_time()
        for message in messages:
            list(core.handle(message))
        spent.append((time.process_time() - before) * 1e3)
    return {"median_ms": float(np.median(spent)), "p99_ms": float(np.percentile(spent, 99))}


def draw(path: Path) -> None:
    """The paper's four panels."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, len(SHOWN), figsize=(16, 4.4))
    shown = {number: tracks for number, _, tracks in figure_9() if number in SHOWN}
    for axis, (number, tracks) in zip(axes, shown.items(), strict=True):
        axis.plot([0, ROOM_M, ROOM_M, 0, 0], [0, 0, ROOM_M, ROOM_M, 0], color="black")
        for track in tracks.tracks:
            if track.probability <= 0.005:
                continue
            x, y = [p.x for p in track.history], [p.y for p in track.history]
            right, up = x[0] > ROOM_M / 2, y[0] > ROOM_M / 2
            colour = "tab:blue" if right == up and not up else "tab:grey"
            axis.plot(x, y, ".-", color=colour, linewidth=0.5 + 3 * track.probability)
            axis.plot(x[-1], y[-1], "o", color=colour)
            # beside the start: at the centre of the room all of them meet
            axis.annotate(
                f"{track.probability:.0%}",
                (x[0], y[0]),
                (0, 8 if up else -16),
                textcoords="offset points",
                ha="center",
                color=colour,
            )
        axis.set(title=f"after {number} observations", aspect="equal", xlabel="m")
    figure.suptitle(
        "Four symmetric hypotheses in a square room; the robot drives from low left (blue)", y=1.02
    )
    figure.savefig(path, dpi=120, bbox_inches="tight")
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--picture", type=Path, help="draw figure 9 to this file")
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    arguments = parser.parse_args()
    result: dict[str, Any] = {"cost": {str(count): cost(count) for count in (30, 200)}, "figure_9": {}}
    for method in ("mixture", "paper"):
        result["figure_9"][method] = {
            number: [round(track.probability, 4) for track in tracks.tracks[:4]]
            for number, _, tracks in figure_9(method)
            if number in SHOWN
        }
    print(f"{'hypotheses':>12} {'median ms':>10} {'p99 ms':>8}")
    for count, row in result["cost"].items():
        print(f"{count:>12} {row['median_ms']:>10.2f} {row['p99_ms']:>8.2f}")
    for method, panels in result["figure_9"].items():
        for number, probabilities in panels.items():
            print(f"figure 9, {method}, after {number:>2}: {probabilities}")
    if arguments.picture:
        draw(arguments.picture)
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
