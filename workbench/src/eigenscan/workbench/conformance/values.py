"""Values that no message may hold: the contract's rules on numbers, for each message type."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles, SearchRequest
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Tracks
from google.protobuf.message import Message

SUM_TOLERANCE = 1e-3
_HEADING_SLACK = 1e-9


def faults(message: Message) -> Iterator[str]:
    """Texts on the bad numbers of one message; none for types without rules."""
    if isinstance(message, Scan):
        yield from _scan(message)
    elif isinstance(message, Hypotheses):
        yield from _hypotheses(message)
    elif isinstance(message, Obstacles):
        if set(message.mask) - {0, 1, 255}:
            yield "a byte of mask is none of 0, 1, 255"
        yield from _pose(message.pose, "pose")
    elif isinstance(message, SearchRequest):
        yield from _pose(message.pose, "pose")
        yield from _pose(message.velocity, "velocity", turns=True)
        yield from _covariance(message.covariance, "covariance")
    elif isinstance(message, PoseEstimate):
        yield from _pose(message.pose, "pose")
        yield from _covariance(message.covariance, "covariance")
        yield from _probability(message.confidence, "confidence")
        yield from _probability(message.none_probability, "none_probability")
    elif isinstance(message, Tracks):
        yield from _tracks(message)


def _scan(scan: Scan) -> Iterator[str]:
    if not (math.isfinite(scan.angle_min) and math.isfinite(scan.angle_increment)):
        yield "an angle is not finite"
    elif not scan.angle_increment > 0.0:
        yield f"angle_increment is {scan.angle_increment:g}, not above 0"
    yield from _pose(scan.mount, "mount")
    ranges = np.array(scan.ranges, dtype=np.float32)
    if not len(ranges):
        yield "a scan has no beams"
    given = ranges[np.isfinite(ranges) | np.isneginf(ranges)]
    low, high = np.float32(scan.range_min), np.float32(scan.range_max or np.inf)
    outside = given[(given < low) | (given > high) | (given <= 0.0)]
    if len(outside):
        yield f"a range is {outside[0]:g} m, neither within its limits nor NaN nor +inf"


def _hypotheses(message: Hypotheses) -> Iterator[str]:
    values = np.array([h.log_likelihood for h in message.hypotheses])
    if not np.isfinite(values).all() or not math.isfinite(message.unlisted_log_likelihood):
        yield "a log-likelihood is not finite"
    elif (np.diff(values) > 0.0).any():
        yield "the hypotheses are not ordered, most likely first"
    for number, hypothesis in enumerate(message.hypotheses):
        yield from _pose(hypothesis.pose, f"hypotheses[{number}].pose")
        yield from _covariance(hypothesis.covariance, f"hypotheses[{number}].covariance")
    if message.status == Hypotheses.STATUS_UNUSABLE_SCAN and message.hypotheses:
        yield "STATUS_UNUSABLE_SCAN with hypotheses"
    if message.status == Hypotheses.STATUS_OK and not message.searched_area_m2 > 0.0:
        yield "searched_area_m2 is not above 0"
    if message.status == Hypotheses.STATUS_UNSPECIFIED:
        yield "the status is not given"


def _tracks(message: Tracks) -> Iterator[str]:
    yield from _probability(message.none_probability, "none_probability")
    for number, track in enumerate(message.tracks):
        yield from _probability(track.probability, f"tracks[{number}].probability")
        yield from _pose(track.pose, f"tracks[{number}].pose")
        yield from _covariance(track.covariance, f"tracks[{number}].covariance")
    total = message.none_probability + sum(track.probability for track in message.tracks)
    if not abs(total - 1.0) <= SUM_TOLERANCE:
        yield f"the probabilities of all tracks and none_probability sum to {total:g}, not to 1"


def _pose(pose: Pose2, name: str, *, turns: bool = False) -> Iterator[str]:
    if not (math.isfinite(pose.x) and math.isfinite(pose.y) and math.isfinite(pose.theta)):
        yield f"{name} is not finite"
    elif not turns and not -math.pi - _HEADING_SLACK <= pose.theta <= math.pi + _HEADING_SLACK:
        yield f"{name}.theta is {pose.theta:g}, not in [-pi, pi)"


def _covariance(covariance: Covariance3, name: str) -> Iterator[str]:
    c = covariance
    values = np.array([[c.xx, c.xy, c.xt], [c.xy, c.yy, c.yt], [c.xt, c.yt, c.tt]])
    if not np.isfinite(values).all():
        yield f"{name} is not finite"
    elif np.linalg.eigvalsh(values)[0] < -1e-9 * max(1.0, float(np.abs(values).max())):
        yield f"{name} has a negative eigenvalue"


def _probability(value: float, name: str) -> Iterator[str]:
    if not 0.0 <= value <= 1.0:
        yield f"{name} is {value:g}, not in [0, 1]"
