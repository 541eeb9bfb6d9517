"""Word from outside about where the robot is: an operator's click, a marker, or "search again".

The word overrules what was believed, but it is not the truth: people click beside the robot, and into the
wrong one of two rooms alike. So it takes most of the mass, and the next scans decide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.pose import FARTHEST_M, covariance_from_message, from_message
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.tracking_pb2 import Relocation
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.covariance import is_covariance
from eigenscan.tracker.observation import Observation, limit_sigma
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.tracks import begin, join, replace
from numpy.typing import NDArray

Array = NDArray[np.float64]

BELIEVED = 0.99
"""Share of the mass that the word takes: one in a hundred is of a wrong place."""
CLICKED_SIGMA = np.array([0.5, 0.5, np.pi / 12.0])
"""m, m, rad of a pose without a covariance: what RViz states for a click."""
SAME_TIME_NS = 1_000_000_000
"""A stamp farther than this from the scan's is of another clock: the pose counts as of the scan."""


@dataclass(frozen=True)
class Hint:
    """Where somebody puts the robot's base: pose (3,), covariance (3, 3), `frame` empty: the next scan's."""

    stamp: int
    frame: str
    pose: Array
    covariance: Array


def hint_of(message: Relocation) -> Hint | None:
    """The hint in a message; None where the robot may be anywhere.

    Raises ValueError where the pose is none.
    """
    if not message.HasField("pose"):
        return None
    pose = from_message(message.pose)
    if not np.isfinite(pose).all() or (np.abs(pose[:2]) > FARTHEST_M).any():
        raise ValueError("the pose is none")
    covariance = covariance_from_message(message.covariance)
    if not is_covariance(covariance[None])[0]:
        covariance = np.diag(CLICKED_SIGMA**2)
    return Hint(nanoseconds(message.timestamp), message.frame_id, pose, limit_sigma(covariance[None])[0])


def aged(last: Relocation, age: float, settings: TrackerSettings) -> Relocation:
    """The hint of `age` s ago, unsure by what it may have driven: W = T^2 v_max^2 (paper, section 7)."""
    grown = Relocation()
    grown.CopyFrom(last)
    grown.covariance.xx += (age * settings.v_max) ** 2
    grown.covariance.yy += (age * settings.v_max) ** 2
    grown.covariance.tt += (age * settings.turn_max) ** 2
    return grown


def heed(belief: Belief, hint: Hint, seen: Observation, moved: Motion) -> None:
    """Begins a track at the hint, in the frame of `seen`; `moved` leads from the hint's time to the scan."""
    frame = belief.frame_index(seen.frame, seen.area)
    belief.source_index(seen.source)
    x, C = predict(hint.pose[None], hint.covariance[None], moved, belief.settings)
    evidence = np.zeros((1, len(belief.sources)))
    track = begin(x, limit_sigma(C), np.log([BELIEVED]), np.zeros(1), evidence, frame, seen.stamp)
    unseen = replace(track, observations=np.zeros(1, dtype=np.intp))
    belief.elsewhere.log_weight += np.log1p(-BELIEVED)
    belief.tracks = join([belief.tracks, unseen])
    belief.normalise()
