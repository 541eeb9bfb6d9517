"""What a localizer answers, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from eigenscan.geometry.pose import Array, covariance_from_message, from_message
from eigenscan.localize.scan import Scan
from eigenscan.schemas import hypotheses_pb2, tracking_pb2

State = Literal["lost", "ambiguous", "localized"]

_STATES: dict[int, State] = {
    tracking_pb2.STATE_AMBIGUOUS: "ambiguous",
    tracking_pb2.STATE_LOCALIZED: "localized",
}


@dataclass(frozen=True)
class Hypotheses:
    """Where one scan may have been taken, most likely first; none where it says nothing.

    `poses` (n, 3): the robot's base in the map frame, m, m, rad; `covariances` (n, 3, 3) of each, given that
    it is the right one; `log_likelihoods` (n,): ln p(scan | pose) / p(scan | a place that the map lacks), so
    that differences are log odds and 0 is no better than chance.
    """

    poses: Array
    covariances: Array
    log_likelihoods: Array
    scan: Scan

    @classmethod
    def of(cls, message: hypotheses_pb2.Hypotheses, scan: Scan) -> Hypotheses:
        """The same as the contract's message."""
        listed = message.hypotheses
        return cls(
            np.array([from_message(h.pose) for h in listed]).reshape(-1, 3),
            np.array([covariance_from_message(h.covariance) for h in listed]).reshape(-1, 3, 3),
            np.array([h.log_likelihood for h in listed], dtype=np.float64),
            scan,
        )


@dataclass(frozen=True)
class Estimate:
    """Where the robot is, by all that was tracked: act on `pose` only where `state` is "localized".

    `pose` (3,): the base in the map frame, m, m, rad, NaN where there is none; `covariance` (3, 3);
    `confidence`: the probability that the true pose is within 0.5 m and 10 degrees.
    """

    state: State
    pose: Array
    covariance: Array
    confidence: float

    @classmethod
    def of(cls, message: tracking_pb2.PoseEstimate) -> Estimate:
        """The same as the contract's message."""
        known = message.track_id != 0
        return cls(
            _STATES.get(message.state, "lost"),
            from_message(message.pose) if known else np.full(3, np.nan),
            covariance_from_message(message.covariance) if known else np.full((3, 3), np.nan),
            message.confidence,
        )
