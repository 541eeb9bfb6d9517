from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
import pytest
from eigenscan.geometry.pose import covariance_to_message, to_message, to_pose3
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, POSE, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import ArrayLike

MakeCore = Callable[..., TrackerCore]
PosesOf = Callable[[Iterable[Envelope]], list[PoseEstimate]]
TracksOf = Callable[[Iterable[Envelope]], list[Tracks]]

TRUST = TrackerSettings().trust
"""Likelihoods here are as the tracker takes them, after its exponent."""
SIGMA = np.array([0.05, 0.05, 0.0175])


@dataclass
class Speaker:
    """Publishes what a projector and a robot base would."""

    area: float = 400.0
    unlisted: float = 0.0
    clutter: int = 8
    covariance: np.ndarray = field(default_factory=lambda: np.diag(SIGMA**2))

    def address(self, lidar: str = "front", projector: str = "0") -> dict[str, str]:
        return {"site": "s", "robot": "r", "lidar": lidar, "projector": projector}

    def hypotheses(
        self,
        time: float,
        poses: Iterable[ArrayLike],
        log_likelihoods: Iterable[float],
        *,
        lidar: str = "front",
        projector: str = "0",
        frame: str = "map",
        status: Hypotheses.Status = Hypotheses.STATUS_OK,
        used_beams: int = 90,
        inexactness: float = 0.0,
        gathered: float = 0.0,
    ) -> Envelope:
        listed = [*zip(poses, log_likelihoods, strict=True)]
        if listed:
            # a projector lists many that fit badly: the right ones stand above them
            listed += [(np.array([100.0 + 5.0 * k, 0.0, 0.0]), 2.0 + k) for k in range(self.clutter)]
        message = Hypotheses(
            timestamp=stamp(round(time * 1e9)),
            frame_id=frame,
            status=status,
            used_beams=used_beams,
            inexactness=inexactness,
            gathered=gathered,
            unlisted_log_likelihood=self.unlisted / TRUST,
            searched_area_m2=self.area,
            hypotheses=[
                Hypothesis(
                    pose=to_message(pose),
                    covariance=covariance_to_message(self.covariance),
                    log_likelihood=float(value) / TRUST,
                )
                for pose, value in listed
            ],
        )
        return Envelope(HYPOTHESES, self.address(lidar, projector), message)

    def odometry(self, time: float, pose: np.ndarray) -> Envelope:
        message = Odometry(
            timestamp=stamp(round(time * 1e9)), frame_id="odom", body_frame_id="base", pose=to_pose3(pose)
        )
        return Envelope(ODOMETRY, {"site": "s", "robot": "r"}, message)


@pytest.fixture
def speaker() -> Speaker:
    return Speaker()


@pytest.fixture
def make_core() -> MakeCore:
    def make(**settings: object) -> TrackerCore:
        return TrackerCore(TrackerSettings.model_validate(settings))

    return make


@pytest.fixture
def poses_of() -> PosesOf:
    return lambda output: [each.open(PoseEstimate) for each in output if each.channel is POSE]


@pytest.fixture
def tracks_of() -> TracksOf:
    return lambda output: [each.open(Tracks) for each in output if each.channel is TRACKS]
