"""The robot's position in the standard's terms: its map, its position there, and the deviation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import Array, compose, covariance_from_message, from_message
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate

USUAL_RISK = 1e-3
"""Risk of the deviation range if the tracker has no protection level."""


@dataclass(frozen=True)
class Maps:
    """The maps of a site by mapId, each with its origin (3,) in the site's own frame `frame`."""

    own: str
    frame: str = ""
    floors: Mapping[str, Array] = field(default_factory=dict)

    def with_models(self, message: ModelSet) -> Maps:
        """The maps of a new model set, without floors whose origin is invalid."""
        floors = {floor.name: from_message(floor.origin) for floor in message.floors if floor.name}
        usable = {name: origin for name, origin in floors.items() if np.isfinite(origin).all()}
        return Maps(self.own, message.frame_id, usable)

    def ids(self) -> list[str]:
        """All mapIds."""
        return list(self.floors) or [self.own]

    def to_site(self, map_id: str, pose: Array) -> Array:
        """A pose (3,) on a map, in the site's frame. Raises KeyError for an unknown map."""
        if not self.floors and map_id == self.own:
            return pose
        return compose(self.floors[map_id], pose)


def is_finite(estimate: PoseEstimate) -> bool:
    """Whether an estimate's pose is a pose."""
    poses = [estimate.pose, estimate.floor_pose] if estimate.floor else [estimate.pose]
    return all(bool(np.isfinite(from_message(pose)).all()) for pose in poses)


def claims(estimate: PoseEstimate | None) -> bool:
    """Whether the tracker claims the pose."""
    return estimate is not None and estimate.state == STATE_LOCALIZED


def position(estimate: PoseEstimate | None, maps: Maps, localized: bool, major: int) -> dict[str, Any] | None:
    """AgvPosition (version 2) or mobileRobotPosition (3); None if no pose is known."""
    if estimate is None or not estimate.track_id:
        return None
    if maps.floors and not estimate.floor:  # on none of the maps
        return None
    pose = from_message(estimate.floor_pose if estimate.floor else estimate.pose)
    fields: dict[str, Any] = {
        "x": float(pose[0]),
        "y": float(pose[1]),
        "theta": float(wrap(pose[2])),
        "mapId": estimate.floor or maps.own,
        "positionInitialized" if major == 2 else "localized": localized,
    }
    if math.isfinite(estimate.confidence):
        fields["localizationScore"] = max(0.0, min(1.0, estimate.confidence))
    deviation = deviation_range(estimate)
    if localized and deviation is not None:
        fields["deviationRange"] = deviation
    return fields


def deviation_range(estimate: PoseEstimate) -> float | None:
    """m: the protection radius, or else a bound from the covariance; None if unknown.

    The true position is farther off with at most the protection level's risk r: for a normal distribution
    P(|d| > R) <= exp(-R^2 / (2 s^2)), where s is the greatest standard deviation.
    """
    if estimate.HasField("protection_radius"):
        radius = estimate.protection_radius
        return radius if math.isfinite(radius) and radius >= 0.0 else None
    covariance = covariance_from_message(estimate.covariance)[:2, :2]
    if not np.isfinite(covariance).all() or not covariance.any():
        return None
    greatest = float(np.linalg.eigvalsh(covariance)[-1])
    risk = estimate.protection_risk if 0.0 < estimate.protection_risk < 1.0 else USUAL_RISK
    bound = math.sqrt(-2.0 * math.log(risk) * max(greatest, 0.0))
    return bound if math.isfinite(bound) else None
