"""Where a pose is: its floor by the models' floors, and what several map frames may claim."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from eigenscan.eigenspace.floors import Floor
from eigenscan.geometry.pose import compose, from_message
from eigenscan.schemas.channels import MODEL_SET, POSE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, PoseEstimate
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.floors import Building

from tests.services.tracker.conftest import MakeCore, Speaker

HERE = np.array([3.0, 2.0, 0.3])
UP = np.array([5.0, 42.0, math.pi / 2])
"""Origin of the upper floor's own map frame in the site's."""


def box(name: str, origin: np.ndarray) -> Floor:
    """A floor of 20 x 20 m, its corners as its own map has them."""
    corners = np.array([[0, 0, 0], [20, 0, 0], [20, 20, 0], [0, 20, 0]], dtype=float)
    return Floor(name, origin, compose(origin, corners)[:, :2])


def models(*floors: Floor, frame: str = "map") -> Envelope:
    message = ModelSet(frame_id=frame, floors=[floor.to_message() for floor in floors])
    return Envelope(MODEL_SET, {"site": "s"}, message)


BUILDING = models(box("ground", np.zeros(3)), box("first", UP))


def drive(
    core: TrackerCore, speaker: Speaker, at: np.ndarray, begin_s: float, scans: int = 15
) -> list[PoseEstimate]:
    """Poses while the robot drives on from `at` with odometry, 0.1 m a scan."""
    output: list[Envelope] = []
    for number in range(scans):
        step = np.array([0.1 * number, 0.0, 0.0])
        output += core.handle(speaker.odometry(begin_s + 0.1 * number, step))
        output += core.handle(speaker.hypotheses(begin_s + 0.1 * number, [compose(at, step)], [20.0]))
    return [each.open(PoseEstimate) for each in output if each.channel is POSE]


def test_a_pose_names_its_floor_and_is_reported_in_that_floors_own_frame(
    make_core: MakeCore, speaker: Speaker
) -> None:
    core = make_core()
    core.handle(BUILDING)
    ground = drive(core, speaker, HERE, 0.0)[-1]
    assert (ground.state, ground.floor) == (STATE_LOCALIZED, "ground")
    assert from_message(ground.floor_pose) == pytest.approx(from_message(ground.pose))

    core = make_core()
    core.handle(BUILDING)
    upstairs = drive(core, speaker, compose(UP, HERE), 0.0)[-1]
    assert (upstairs.state, upstairs.floor) == (STATE_LOCALIZED, "first")
    assert from_message(upstairs.floor_pose) == pytest.approx(compose(HERE, [1.4, 0.0, 0.0]), abs=0.05)


@pytest.mark.parametrize(
    "floors",
    [
        [models()],
        [models(box("ground", np.zeros(3)), frame="another")],
        [models(box("elsewhere", np.array([500.0, 0.0, 0.0])))],
        [BUILDING, models()],
        [],
    ],
    ids=["one map", "another frame", "on none", "no floors any more", "no models"],
)
def test_what_is_on_no_floor_names_none(
    make_core: MakeCore, speaker: Speaker, floors: Iterable[Envelope]
) -> None:
    core = make_core()
    for message in floors:
        core.handle(message)
    (*_, last) = drive(core, speaker, HERE, 0.0)
    assert last.state == STATE_LOCALIZED
    assert last.floor == ""
    assert not last.HasField("floor_pose")


@pytest.mark.parametrize(
    "floor",
    [
        ModelSet.Floor(name="no corners"),
        ModelSet.Floor(name="three", outline_x=[0, 9, 9], outline_y=[0, 0, 9]),
        ModelSet.Floor(name="uneven", outline_x=[0, 9, 9, 0], outline_y=[0, 0, 9]),
        ModelSet.Floor(name="no number", outline_x=[0, math.nan, 9, 0], outline_y=[0, 0, 9, 9]),
        ModelSet.Floor(name="far", outline_x=[0, 1e300, 9, 0], outline_y=[0, 0, 9, 9]),
        ModelSet.Floor(name="flat", outline_x=[0, 0, 0, 0], outline_y=[0, 0, 9, 9]),
        ModelSet.Floor(outline_x=[0, 9, 9, 0], outline_y=[0, 0, 9, 9]),
    ],
    ids=lambda floor: floor.name or "no name",
)
def test_what_is_no_floor_is_counted_and_the_others_stay(
    make_core: MakeCore, speaker: Speaker, floor: ModelSet.Floor
) -> None:
    core = make_core()
    message = ModelSet(frame_id="map", floors=[floor, box("ground", np.zeros(3)).to_message()])
    core.handle(Envelope(MODEL_SET, {"site": "s"}, message))
    assert drive(core, speaker, HERE, 0.0)[-1].floor == "ground"
    assert core.condition().counters["floor_not_usable"] == 1


def in_sight(*shares: float, sizes: tuple[int, ...] = (1000, 1000)) -> Envelope:
    """A set of regions, of whose beams these shares meet a wall."""
    entries = [
        ModelSet.Entry(size=size, walls_in_sight=own) for size, own in zip(sizes, shares, strict=False)
    ]
    return Envelope(MODEL_SET, {"site": "s"}, ModelSet(frame_id="map", entries=entries))


@pytest.mark.parametrize(
    ("announced", "share"),
    [
        (in_sight(0.6, 0.6), 0.4**2),
        (in_sight(0.9, 0.5, sizes=(3000, 1000)), 0.2**2),
        (in_sight(0.95), 0.02),
        (in_sight(), 0.02),
        (in_sight(0.0, 0.5), 0.5**2),
        (in_sight(math.nan, 1.5), 0.02),
        (in_sight(0.3, sizes=(0,)), 0.02),
        (in_sight(1e-300), 0.5),
    ],
    ids=["open", "by size", "walled", "no regions", "one not stated", "no shares", "no size", "no wall"],
)
def test_where_few_beams_meet_a_wall_more_robots_are_off_the_map(announced: Envelope, share: float) -> None:
    assert Building.of(announced.open(ModelSet), Counter()).off_map_share == pytest.approx(share)


def test_the_robots_off_the_map_are_as_many_as_the_models_state(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """Where no list has anything for five metres, a place found then is against the mass off the map."""
    none = []
    for share in (0.95, 0.5):
        core = make_core()
        core.handle(in_sight(share))
        for number in range(10):
            core.handle(speaker.odometry(number, np.array([0.5 * number, 0.0, 0.0])))
            core.handle(speaker.hypotheses(number, [], []))
        core.handle(speaker.odometry(10.0, np.array([5.0, 0.0, 0.0])))
        (pose,) = (
            each.open(PoseEstimate)
            for each in core.handle(speaker.hypotheses(10.0, [HERE], [12.0]))
            if each.channel is POSE
        )
        none.append(pose.none_probability)
    assert none[0] < none[1]


FRAMES = ("ground", "first")
ORDERS: dict[str, Callable[[int], tuple[int, ...]]] = {
    "both of each scan": lambda _: (0, 1),
    "by turns": lambda number: (number % 2,),
    "one more often": lambda number: (0, 0, 1)[number % 3 : number % 3 + 1],
    "ten of each": lambda number: (number // 10 % 2,),
}


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("rate_hz", [0.2, 1.0, 10.0])
@pytest.mark.parametrize("has_odometry", [True, False])
def test_one_place_in_two_map_frames_is_ambiguous_and_health_names_them(
    make_core: MakeCore,
    speaker: Speaker,
    order: str,
    rate_hz: float,
    has_odometry: bool,
) -> None:
    core, pose, output, reasons = make_core(), HERE, list[PoseEstimate](), set[str]()
    for number in range(60):
        at = number / rate_hz
        out: list[Envelope] = []
        if has_odometry:
            out += core.handle(speaker.odometry(at, pose))
        for frame in ORDERS[order](number):
            listed = speaker.hypotheses(at, [pose], [20.0], projector=FRAMES[frame], frame=FRAMES[frame])
            out += core.handle(listed)
        output += [each.open(PoseEstimate) for each in out if each.channel is POSE]
        if core.condition().status == Health.STATUS_DEGRADED:
            reasons.add(core.condition().detail)
        pose = compose(pose, [0.5 / rate_hz, 0.0, 0.05 / rate_hz])
    alone = next(
        number for number, one in enumerate(output) if one.frame_id != output[0].frame_id or number == 11
    )
    later = output[alone:]  # before, one frame was all that there was
    assert not [one for one in later if one.state == STATE_LOCALIZED]
    assert {one.state for one in later} >= {STATE_AMBIGUOUS}
    assert any("'first' and 'ground'" in reason for reason in reasons), reasons


def test_frames_of_which_one_fits_keep_the_claim(make_core: MakeCore, speaker: Speaker) -> None:
    core, output = make_core(), list[Envelope]()
    for number in range(40):
        pose, at = compose(HERE, [0.05 * number, 0.0, 0.0]), 0.1 * number
        output += core.handle(speaker.odometry(at, pose))
        output += core.handle(speaker.hypotheses(at, [pose], [20.0], projector="0", frame="ground"))
        output += core.handle(speaker.hypotheses(at, [pose], [1.0], projector="1", frame="first"))
    states = [one.open(PoseEstimate).state for one in output if one.channel is POSE]
    assert states[4:] == [STATE_LOCALIZED] * (len(states) - 4)
    assert core.condition().status == Health.STATUS_OK


def test_a_robot_that_leaves_a_lift_into_another_frame_is_claimed_there_at_its_next_scan(
    make_core: MakeCore, speaker: Speaker
) -> None:
    """Each floor has a projector and a map frame of its own; what does not fit is listed faintly."""
    core, frames, claims = make_core(), list[str](), list[tuple[int, str]]()
    for number in range(80):
        up = number >= 40
        pose, at = compose(HERE, [0.05 * number, 0.0, 0.0]), 0.1 * number
        out = [*core.handle(speaker.odometry(at, pose))]
        for frame, fits in (("ground", not up), ("first", up)):
            out += core.handle(
                speaker.hypotheses(at, [pose], [25.0 if fits else -8.0], projector=frame, frame=frame)
            )
        for one in out:
            if one.channel is POSE and one.open(PoseEstimate).state == STATE_LOCALIZED:
                frames.append(one.open(PoseEstimate).frame_id)
                claims.append((number, frames[-1]))
    assert frames == sorted(frames, reverse=True)  # ground, then first, never back
    assert (max(number for number, frame in claims if frame == "ground")) <= 50
    assert (min(number for number, frame in claims if frame == "first")) <= 60


def test_a_frame_that_is_silent_for_long_holds_nothing_up(make_core: MakeCore, speaker: Speaker) -> None:
    core, output = make_core(), list[Envelope]()
    for number in range(80):
        pose, at = compose(HERE, [0.05 * number, 0.0, 0.0]), 0.1 * number
        frame = "ground" if number < 20 else "first"  # its projector was started again with another name
        output += core.handle(speaker.odometry(at, pose))
        output += core.handle(speaker.hypotheses(at, [pose], [20.0], projector=frame, frame=frame))
    last = [one.open(PoseEstimate) for one in output if one.channel is POSE][-1]
    assert (last.state, last.frame_id) == (STATE_LOCALIZED, "first")


@pytest.mark.parametrize("floors", [1, 2])
def test_where_there_are_several_floors_a_robot_that_no_scan_shows_may_be_in_a_lift(
    make_core: MakeCore, speaker: Speaker, floors: int
) -> None:
    """It stands in the cabin for 4 s; then one list shows a good place on the other floor."""
    core = make_core()
    core.handle(BUILDING if floors == 2 else models(box("ground", np.zeros(3))))
    assert drive(core, speaker, HERE, 0.0)[-1].floor == "ground"
    cabin = compose(HERE, [1.4, 0.0, 0.0])

    def see(number: int, poses: list[np.ndarray]) -> PoseEstimate:
        at = 1.5 + 0.1 * number
        core.handle(speaker.odometry(at, np.array([1.4, 0.0, 0.0])))
        output = core.handle(speaker.hypotheses(at, [*poses, cabin + 60.0], [18.0] * len(poses) + [9.0]))
        return [each.open(PoseEstimate) for each in output if each.channel is POSE][-1]

    hidden = [see(number, []) for number in range(40)]
    assert {one.state for one in hidden} == {STATE_LOCALIZED}
    out = see(40, [compose(UP, HERE)])
    assert (out.state == STATE_LOCALIZED) == (floors == 1)


@pytest.mark.parametrize("floors", [1, 2])
def test_in_a_building_with_floors_a_claim_that_no_scan_shows_does_not_last(
    make_core: MakeCore, speaker: Speaker, floors: int
) -> None:
    core = make_core()
    core.handle(BUILDING if floors == 2 else models(box("ground", np.zeros(3))))
    drive(core, speaker, HERE, 0.0)
    claimed = 0
    for number in range(600):
        at = 1.5 + 0.1 * number
        core.handle(speaker.odometry(at, np.array([1.4, 0.0, 0.0])))
        output = core.handle(speaker.hypotheses(at, [np.array([80.0, 80.0, 0.0])], [9.0]))
        claimed += sum(
            each.open(PoseEstimate).state == STATE_LOCALIZED for each in output if each.channel is POSE
        )
    assert (claimed == 600) == (floors == 1)
    assert claimed > 50
