"""`eigenscan run --ros2` without a map: the robot's own, by the bridge's settings."""

from pathlib import Path

import numpy as np
import pytest
from eigenscan.cli.launch import attend
from eigenscan.cli.launch.services import Pipeline
from eigenscan.cli.run import run
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.ros_bridge import robot_map
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.settings import qualified
from eigenscan.runtime.settings import load


@pytest.mark.parametrize(
    ("changes", "asked"),
    [
        ([], "/map"),
        (["ros-bridge.namespace=r17"], "/r17/map"),
        (["ros-bridge.namespace=r17", "ros-bridge.map=/floors/map"], "/floors/map"),
        (["ros-bridge.map="], "/map"),  # as with a map_server
    ],
)
def test_the_robots_map_is_taken_from_where_the_bridges_settings_name_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changes: list[str], asked: str
) -> None:
    names, bridges = [], []

    def take(settings: RosBridgeOptions, _patience_s: float) -> GridMap:
        names.append(qualified(settings.namespace, settings.map))
        return GridMap(
            np.full((40, 40), FREE, np.uint8) | np.eye(40, dtype=np.uint8) * OCCUPIED, 0.05, np.zeros(3)
        )

    def attended(pipeline: Pipeline, *_: object, **__: object) -> None:
        given = [*(pipeline.ros2_flags or ()), *pipeline.flags["ros-bridge"]]
        bridges.append(load(RosBridgeOptions, "ros-bridge", given))

    monkeypatch.setattr(robot_map, "take_map", take)
    monkeypatch.setattr(attend, "attend", attended)
    run(ros2="rmw_zenoh", out=tmp_path / "out", changes=changes)
    assert names == [asked]
    assert [bridge.map for bridge in bridges] == [""]  # the robot publishes its own
