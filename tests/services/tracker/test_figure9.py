"""The paper's figure 9: four symmetric hypotheses in a square room, until what breaks the symmetry tells.

Lists and likelihoods are typed here: this is of the tracker alone.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, covariance_to_message, to_message, to_pose3
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.tracking_pb2 import Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

ROOM_M = 8.0
OBSERVATIONS = 26
STEP_M = 0.3
ROBOT = {"site": "figure", "robot": "r"}
SIGMA = np.array([0.06, 0.06, 0.02])


def quarter_turns(pose: np.ndarray) -> np.ndarray:
    """The pose (3,) and its three images in the square room, (4, 3)."""
    centre = np.array([ROOM_M / 2, ROOM_M / 2, 0.0])
    turns = np.array([[0.0, 0.0, k * np.pi / 2] for k in range(4)])
    return compose(centre, compose(turns, pose - centre))


def heard(time_s: float, poses: np.ndarray, fits: np.ndarray) -> Envelope:
    """A projector's answer."""
    message = Hypotheses(
        timestamp=stamp(round(time_s * 1e9)),
        frame_id="map",
        status=Hypotheses.STATUS_OK,
        searched_area_m2=ROOM_M**2,
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
    for number in range(1, OBSERVATIONS + 1):
        poses = quarter_turns(truth) + rng.normal(size=(4, 3)) * SIGMA / 2
        # the niche is far at first: its few beams hardly tell; near, they do
        seen = 4.0 * (number / OBSERVATIONS) ** 2
        fits = 18.0 + 0.4 * rng.normal(size=4) - seen * np.array([0.0, 1.0, 1.0, 1.0])
        list(core.handle(odometry(float(number), driven)))
        for said in core.handle(heard(float(number), poses, fits)):
            if said.channel is TRACKS:
                yield number, truth, said.open(Tracks)
        step = np.array([STEP_M, 0.0, 0.0])
        truth, driven = compose(truth, step), compose(driven, step)


@pytest.mark.parametrize("method", ["mixture", "paper"])
@pytest.mark.parametrize("seed", [9, 10, 11, 12])
def test_the_right_trajectory_is_confirmed(method: str, seed: int) -> None:
    panels = {number: (truth, tracks) for number, truth, tracks in figure_9(method, seed)}
    _, early = panels[3]
    alive = [track.probability for track in early.tracks if track.probability > 0.05]
    assert len(alive) >= 3
    assert max(alive) < 0.75
    truth, late = panels[26]
    best = late.tracks[0]
    assert best.probability > 0.95
    assert np.hypot(best.pose.x - truth[0], best.pose.y - truth[1]) < 0.1
    # it is one trajectory, from low-left to upper-right
    assert best.history[0].x < 2.0
    assert best.history[0].y < 2.0
    assert len(best.history) == 26


def test_the_scans_settle_it_little_by_little() -> None:
    shares = {}
    for number, truth, tracks in figure_9("mixture", 9):
        near = [
            t.probability for t in tracks.tracks if np.hypot(t.pose.x - truth[0], t.pose.y - truth[1]) < 0.2
        ]
        shares[number] = sum(near)
    assert shares[3] < shares[15]
    # once it is settled it stays so
    assert min(shares[15], shares[26]) > 0.95
