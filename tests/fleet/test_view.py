"""Poses that no tracker publishes: they ended `run --json` and `fleet status --json` as a fault of ours."""

import json
from collections import deque
from typing import Any

import pytest
from eigenscan.cli.fleet.status import rows
from eigenscan.fleet.view import FleetView
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.schemas.channels import POSE
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode, encoding

NAN, INF = float("nan"), float("inf")


def _received(view: FleetView, **fields: float) -> list[PoseEstimate]:
    confidence, on_floor = fields.pop("confidence", 0.5), Pose2(x=fields.pop("floor_x", 0.0))
    pose = PoseEstimate(pose=Pose2(**fields), confidence=confidence, floor="ground", floor_pose=on_floor)
    key = POSE.key({"site": "s", "robot": "r1"})
    return [one for _, one in view._receive(Arrival(POSE, key, encode(pose), encoding(POSE)), 1.0, 0)]


def test_poses_of_one_robot_are_given_alone() -> None:
    """`eigenscan run` once showed the pose of another robot on its site."""
    view: Any = FleetView.__new__(FleetView)
    view.site, view.robots, view.services, view._tokens, view._inbox = "s", {}, {}, [], Inbox()

    def put() -> None:
        for x, robot in enumerate(("r1", "r2", "r1"), start=1):
            message, key = PoseEstimate(pose=Pose2(x=x)), POSE.key({"site": "s", "robot": robot})
            view._inbox.put(POSE, key, encode(message), encoding(POSE))

    for of, expected in (("r1", [1.0, 3.0]), ("r2", [2.0]), ("r3", []), (None, [1.0, 2.0, 3.0])):
        put()
        assert [pose.pose.x for pose in view.update(of)] == expected
    assert set(view.robots) == {"r1", "r2"}


@pytest.mark.parametrize(
    "fields",
    [
        {"x": NAN},
        {"y": INF},
        {"theta": 1e308},
        {"x": -1e30},
        {"floor_x": NAN},
        {"confidence": NAN},
        {"confidence": 1e308},
    ],
)
def test_what_is_no_pose_is_not_shown(fields: dict[str, float]) -> None:
    view: Any = FleetView.__new__(FleetView)
    view.site, view.robots, view.services, view.model_versions = "s", {}, {}, deque(maxlen=2)
    view.expected = frozenset()
    assert len(_received(view, x=1.0)) == 1
    assert _received(view, **fields) == []
    assert view.robots["r1"].pose.pose.x == 1.0
    json.dumps(rows(view), allow_nan=False)
