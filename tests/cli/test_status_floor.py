"""The fleet's table shows a robot's floor, with the pose in that floor's own map."""

import time

import pytest
from eigenscan.cli.fleet.status import rows, table
from eigenscan.fleet.view import Robot
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from rich.console import Console


class View:
    """What the table asks of a FleetView."""

    def __init__(self, pose: PoseEstimate) -> None:
        self.site, self.model_version = "s", ""
        self.robots = {"r1": Robot("r1", pose=pose, received_at=time.monotonic())}

    def robot_names(self) -> list[str]:
        return [*self.robots]

    def serving(self, _robot: str) -> list[object]:
        return []


@pytest.mark.parametrize(
    ("floor", "place"), [("first", "1.5, 2.5 on first"), ("", "7.0, 42.0"), ("[b]x\x1b", "on [b]x")]
)
def test_a_place_is_reported_on_its_floor(floor: str, place: str) -> None:
    pose = PoseEstimate(state=STATE_LOCALIZED, confidence=0.97, pose=Pose2(x=7.0, y=42.0), floor=floor)
    if floor:
        pose.floor_pose.CopyFrom(Pose2(x=1.5, y=2.5))
    view = View(pose)
    console = Console(width=200)
    with console.capture() as shown:
        console.print(table(view))  # type: ignore[arg-type]
    assert place in shown.get()
    (row,) = rows(view)  # type: ignore[arg-type]
    assert row["floor"] == floor
    assert (row["floor_x"], row["floor_y"]) == ((1.5, 2.5) if floor else (None, None))


def test_a_robots_name_does_not_turn_the_line_around() -> None:
    view = View(PoseEstimate(state=STATE_LOCALIZED))
    view.robots = {"r\u202e1[b]": Robot("r\u202e1[b]", received_at=time.monotonic())}
    console = Console(width=200)
    with console.capture() as shown:
        console.print(table(view))  # type: ignore[arg-type]
    assert "r?1[b]" in shown.get()
