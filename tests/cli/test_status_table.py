"""The fleet's table shows a robot's floor, with the pose in that floor's own map; and its advice."""

import time
from collections.abc import Sequence

import pytest
from eigenscan.cli.fleet.status import rows, table
from eigenscan.cli.launch.attend import pose_text
from eigenscan.fleet.view import Robot, Service
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate, State
from rich.console import Console


class View:
    """What the table asks of a FleetView."""

    def __init__(self, pose: PoseEstimate) -> None:
        self.site, self.model_version = "s", ""
        self.expected: frozenset[str] = frozenset()
        self.robots = {"r1": Robot("r1", pose=pose, received_at=time.monotonic())}

    def is_stranger(self, robot: str) -> bool:
        return bool(self.expected) and robot not in self.expected

    def all_robots(self) -> list[str]:
        return sorted({*self.robots, *self.expected})

    services: Sequence[Service] = ()

    def serving(self, _robot: str) -> Sequence[Service]:
        return self.services


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


@pytest.mark.parametrize(
    ("state", "age_s", "shown"),
    [(STATE_AMBIGUOUS, 0.5, True), (STATE_AMBIGUOUS, 4.0, False), (STATE_LOCALIZED, 0.5, False)],
)
def test_advice_is_below_the_table_while_it_holds(state: State, age_s: float, shown: bool) -> None:
    view = View(PoseEstimate(state=state))
    robot = view.robots["r1"]
    robot.advice = Advice(kind=Advice.KIND_MOVE, heading=0.7, distance=3.21, track_ids=[4, 9])
    robot.advised_at = time.monotonic() - age_s
    words = "drive 3.2 m, 40° to the left, to distinguish 2 places"
    console = Console(width=200)
    with console.capture() as printed:
        console.print(table(view))  # type: ignore[arg-type]
    assert (f"r1: {words}" in printed.get()) == shown
    (row,) = rows(view)  # type: ignore[arg-type]
    assert row["advice"] == (words if shown else "")
    assert (words in pose_text(robot.pose, 0.0, [], robot.advised)) == shown


def test_a_robot_that_the_fleet_does_not_list_is_not_well() -> None:
    view = View(PoseEstimate(state=STATE_LOCALIZED))
    view.expected = frozenset({"r2"})
    view.services = [Service("tracker", "r1", {"1"}, Health(status=Health.STATUS_OK))]
    console = Console(width=200)
    with console.capture() as shown:
        console.print(table(view))  # type: ignore[arg-type]
    assert "revoked or new" in shown.get()
    assert [row["stranger"] for row in rows(view)] == [True, False]  # type: ignore[arg-type]


def test_a_terminal_of_80_columns_shows_every_word() -> None:
    pose = PoseEstimate(
        state=STATE_LOCALIZED, confidence=0.97, pose=Pose2(x=-17.3, y=42.0), model_version="2c0ffee1a"
    )
    view = View(pose)
    view.robots["r1"].received_at -= 90.0
    view.model_version = "another"
    view.services = [Service("tracker", "r1", {"1"}, Health(counters={"dropped_pose": 3}))]
    view.services[0].offsets.append(-7.0)
    console = Console(width=80)
    with console.capture() as printed:
        console.print(table(view))  # type: ignore[arg-type]
    first, heading, *lines = printed.get().splitlines()
    assert "0 of 1 robots localized" in first
    assert heading.split() == ["robot", "state", "confidence", "x,", "y", "(m)", "age", "map", "health"]
    for words in ("r1", "was localized", "0.97", "-17.3, 42.0", "2 min", "2c0ffee1 old"):
        assert words in lines[0]
    wrong = " ".join(line[heading.index("health") :].strip() for line in lines)
    assert wrong == "no scan-ingest, no projector, tracker unknown, 3 drops, clock -7 s"


def test_a_robot_of_the_fleet_that_is_not_there_has_its_row() -> None:
    view = View(PoseEstimate(state=STATE_LOCALIZED))
    view.expected = frozenset({"r1", "r2"})
    assert [(row["robot"], row["state"]) for row in rows(view)] == [  # type: ignore[arg-type]
        ("r1", "localized"),
        ("r2", "unknown"),
    ]
    console = Console(width=80)
    with console.capture() as shown:
        console.print(table(view))  # type: ignore[arg-type]
    assert "1 of 2 robots localized" in shown.get()
    assert shown.get().count("not there") == 2  # r1's services do not answer here either
