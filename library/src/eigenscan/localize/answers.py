"""Answers of a localizer, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from eigenscan.geometry.pose import Array, covariance_from_message, from_message
from eigenscan.localize.scan import Scan
from eigenscan.schemas import tracking_pb2
from eigenscan.schemas.localize_pb2 import LocalizeReply

State = Literal["lost", "ambiguous", "localized"]

_STATES: dict[int, State] = {
    tracking_pb2.STATE_AMBIGUOUS: "ambiguous",
    tracking_pb2.STATE_LOCALIZED: "localized",
}


@dataclass(frozen=True, repr=False, eq=False)
class Hypotheses:
    """Poses at which one scan may have been taken, most likely first; none if the projector lists none.

    `poses` (n, 3): the robot's base in the map frame, m, m, rad. `covariances` (n, 3, 3): of each pose, given
    that it is the right one. `log_likelihoods` (n,): ln p(scan | pose) / p(scan | a place outside the map),
    so differences are log odds, and 0 is no better than chance. `probabilities` (n,) and `none_probability`,
    for a place that is not listed or outside the map, sum to 1. Before the scan, the robot is as likely
    outside the map as on it.
    """

    poses: Array
    covariances: Array
    log_likelihoods: Array
    scan: Scan
    probabilities: Array
    none_probability: float

    def __len__(self) -> int:
        return len(self.poses)

    def __repr__(self) -> str:
        if not len(self.poses):
            return "<Hypotheses: none, the scan shows nothing>"
        best = f"best at {place(self.poses[0])}, log likelihood {self.log_likelihoods[0]:.1f}"
        second = f", the next {self.log_likelihoods[1]:.1f}" if len(self.poses) > 1 else ""
        return f"<Hypotheses: {len(self.poses)}, {best}{second}>"

    @classmethod
    def of(cls, message: LocalizeReply, scan: Scan) -> Hypotheses:
        """The same as the contract's message."""
        listed = message.candidates
        return cls(
            np.array([from_message(h.pose) for h in listed]).reshape(-1, 3),
            np.array([covariance_from_message(h.covariance) for h in listed]).reshape(-1, 3, 3),
            np.array([h.log_likelihood for h in listed], dtype=np.float64),
            scan,
            np.array([h.probability for h in listed], dtype=np.float64),
            message.none_probability,
        )


@dataclass(frozen=True, repr=False, eq=False)
class Estimate:
    """The robot's pose after all tracked scans. Act on `pose` only if `state` is "localized".

    `pose` (3,): the base in the map frame, m, m, rad, NaN if there is none. `covariance` (3, 3).
    `confidence`: probability that the true pose is within 0.5 m and 10 degrees.
    """

    state: State
    pose: Array
    covariance: Array
    confidence: float

    def __repr__(self) -> str:
        at = f" at {place(self.pose)}" if np.isfinite(self.pose).all() else ""
        return f"<Estimate: {self.state}{at}, confidence {self.confidence:.2f}>"

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


def place(pose: Array) -> str:
    """A pose (3,) in words."""
    return f"x {pose[0]:.2f} m, y {pose[1]:.2f} m, heading {np.degrees(pose[2]):.1f} degrees"
