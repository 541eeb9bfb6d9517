"""What a list of hypotheses costs the tracker.

python benchmarks/tracking.py --json tracking.json
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from eigenscan.geometry.pose import compose, covariance_to_message, to_message, to_pose3
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

ROBOT = {"site": "figure", "robot": "r"}
SIGMA = np.array([0.06, 0.06, 0.02])


def received(time_s: float, poses: np.ndarray, fits: np.ndarray, area: float) -> Envelope:
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
            received(0.025 * scan, np.vstack([truth, others]), fits, area=400.0),
        ]
        before = time.process_time()
        for message in messages:
            list(core.handle(message))
        spent.append((time.process_time() - before) * 1e3)
    return {"median_ms": float(np.median(spent)), "p99_ms": float(np.percentile(spent, 99))}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    given = parser.parse_args()
    result = {str(count): cost(count) for count in (30, 200)}
    print(f"{'hypotheses':>12} {'median ms':>10} {'p99 ms':>8}")
    for count, row in result.items():
        print(f"{count:>12} {row['median_ms']:>10.2f} {row['p99_ms']:>8.2f}")
    if given.json:
        given.json.write_text(json.dumps({"cost": result}, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
