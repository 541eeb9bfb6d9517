"""Which move is advised where places fit alike: what it shows, where it leads, and when there is none."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.distance_field import DistanceField
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import compose, to_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.projector.advice import MOST_LIDARS, MOST_PLACES, MOST_TRACKS, Advisor, Places, best_move
from eigenscan.projector.distinction import (
    Lidar,
    expected_share,
    fitted_odds,
    odds,
    rays_of,
    walls_of,
)
from eigenscan.projector.ground import Ground
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Reading, Site
from eigenscan.projector.wall_field import WallField
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.channels import ADVICE, SCAN, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    STATE_UNSPECIFIED,
    State,
    Track,
    Tracks,
)
from numpy.typing import NDArray

from tests.services.projector.office import ADDRESS, free_poses, ready, scan_at

Array = NDArray[np.float64]

S = 1_000_000_000
AROUND = Lidar(Sensor(-math.pi, math.radians(1.0), 360, 12.0), np.zeros(3))
NARROW = Lidar(Sensor(math.radians(-60.0), math.radians(1.0), 121, 12.0), np.zeros(3))
RADIUS, REACH = 0.3, 8.0
APART = 10.0
"""m from a place to its like, along x."""


def building(*boxes: tuple[float, float, float, float, int]) -> Site:
    """Two like rooms of 4 m by 4 m, each with a door of 1 m to a closet north of it; then `boxes`.

    A box: from x, from y, to x, to y, m, and what its cells are.
    """
    cells = np.full((180, 320), UNKNOWN, dtype=np.uint8)

    def fill(x0: float, y0: float, x1: float, y1: float, value: int) -> None:
        cells[round(y0 * 20) : round(y1 * 20), round(x0 * 20) : round(x1 * 20)] = value

    for x in (1.0, 1.0 + APART):
        fill(x - 0.1, 0.9, x + 4.1, 8.1, OCCUPIED)
        fill(x, 1.0, x + 4.0, 5.0, FREE)
        fill(x, 5.1, x + 4.0, 8.0, FREE)
        fill(x + 2.8, 5.0, x + 3.8, 5.1, FREE)
        fill(x, 1.0, x + 0.6, 2.0, OCCUPIED)
    for box in boxes:
        fill(*box)
    return of_map(GridMap(cells, 0.05, np.zeros(3)))


def of_map(grid: GridMap) -> Site:
    """All that advice needs of a site."""
    walls, caster = WallField.of(DistanceField.of(grid)), RayCaster.of(grid)
    site = SimpleNamespace(frame_id="map", drawn=walls, caster=caster, readings=(Reading(walls, caster),))
    return cast(Site, site)


CUPBOARD = (1.0, 6.4, 5.0, 6.5, OCCUPIED)
"""Its front, from wall to wall in the first closet, out of sight of most of the room."""
START = (2.0, 2.6, 0.4)
TWO = Places(np.array([START, (START[0] + APART, *START[1:])]), np.array([0.5, 0.5]), (3, 8))


def test_the_way_leads_to_the_door_behind_which_they_differ() -> None:
    found = best_move(building(CUPBOARD), [AROUND], TWO, RADIUS, REACH)
    assert found is not None
    end = compose(compose(START, [0.0, 0.0, found.move.heading]), [found.move.distance, 0.0, 0.0])
    assert found.probability > 0.85
    assert found.evidence > 2.0
    # nearer to the door, whose middle is at (4.3, 5.05), and not yet through it
    assert math.dist(end[:2], (4.3, 5.05)) < math.dist(START[:2], (4.3, 5.05)) - 1.0
    assert end[1] < 5.3
    assert found.move.distance <= found.move.way + 1e-9 <= REACH


def test_from_there_a_scan_does_distinguish_them_and_from_the_start_not() -> None:
    site = building(CUPBOARD)
    found = best_move(site, [AROUND], TWO, RADIUS, REACH)
    assert found is not None
    there = compose(compose(TWO.poses, [0.0, 0.0, found.move.heading]), [found.move.way, 0.0, 0.0])
    here = odds(site, [AROUND], TWO.poses[None])[0]
    assert here.max() < 0.5
    if found.move.way == pytest.approx(found.move.distance):
        assert fitted_odds(site, [AROUND], there).max() > 2.0


def test_like_buildings_have_no_such_move() -> None:
    assert best_move(building(), [AROUND], TWO, RADIUS, REACH) is None


def test_a_move_that_one_of_the_places_blocks_is_not_advised() -> None:
    # in the second place the door is shut
    shut = building(CUPBOARD, (APART + 3.8, 5.0, APART + 4.8, 5.1, OCCUPIED))
    reached = [
        compose(START, Ground.around(places, walls_of(shut), rays_of(shut), RADIUS, REACH).ends(0.5, 1)[1])
        for places in (TWO.poses[:1], TWO.poses)
    ]
    first_alone, both = (poses[:, 1].max() for poses in reached)
    assert first_alone > 6.0  # through the door
    assert both < 4.8
    found = best_move(shut, [AROUND], TWO, RADIUS, REACH)
    assert found is not None  # the door itself is a difference
    end = compose(compose(START, [0.0, 0.0, found.move.heading]), [found.move.distance, 0.0, 0.0])
    assert end[1] < 4.8


def test_the_way_keeps_clear_of_walls_and_unknown_ground() -> None:
    site = building(CUPBOARD)
    for radius in (0.2, 0.4):
        found = best_move(site, [AROUND], TWO, radius, REACH)
        assert found is not None
        for place in TWO.poses:
            leg = np.linspace(0.0, found.move.distance, 80)[:, None] * [1.0, 0.0, 0.0]
            points = compose(compose(place, [0.0, 0.0, found.move.heading]), leg)[:, :2]
            assert site.drawn.at(points).min() > radius - 0.06
            assert not site.caster.in_dark(points).any()


def test_a_reach_that_is_too_short_has_no_move() -> None:
    assert best_move(building(CUPBOARD), [AROUND], TWO, RADIUS, 0.6) is None


def test_a_narrow_lidar_is_turned_first() -> None:
    # in sight, but behind the robot
    behind = building((3.6, 1.0, 5.0, 2.2, OCCUPIED))
    poses = np.array([(3.0, 3.4, math.pi / 2), (3.0 + APART, 3.4, math.pi / 2)])
    found = best_move(behind, [NARROW], Places(poses, np.array([0.5, 0.5]), (1, 2)), RADIUS, REACH)
    assert found is not None
    assert found.move.distance == found.move.way == 0.0
    # it lies to the right and behind: the nearer turn is clockwise
    assert -math.pi < found.move.heading < -0.5
    around = best_move(behind, [AROUND], Places(poses, np.array([0.5, 0.5]), (1, 2)), RADIUS, REACH)
    assert around is None or around.move.distance > 0.0


def test_a_turn_shows_nothing_new_to_the_lidar_that_sees_all_around() -> None:
    # both lidars see that the places differ, and so they did before the turn
    differ = building((1.0, 4.0, 2.0, 5.0, OCCUPIED), (1.0 + APART, 1.0, 1.0 + APART + 2.4, 2.0, OCCUPIED))
    ahead = Places(TWO.poses + np.array([0.0, 0.6, 0.0]), TWO.shares, TWO.tracks)
    found = best_move(differ, [AROUND], ahead, RADIUS, REACH)
    assert found is not None
    assert found.move.distance > 0.0


def test_an_error_of_a_tracks_pose_is_no_difference_of_places() -> None:
    off = TWO.poses + np.array([[0.0, 0.0, 0.0], [0.06, -0.05, 0.02]])
    assert fitted_odds(building(), [AROUND], off).max() < 0.5
    assert best_move(building(), [AROUND], Places(off, TWO.shares, TWO.tracks), RADIUS, REACH) is None


def test_the_expected_share_is_that_of_bayes() -> None:
    shares, ratio = np.array([0.7, 0.3]), np.array([[[0.0, 2.0], [1.0, 0.0]]])
    one = 0.7 * 0.7 / (0.7 + 0.3 * math.exp(-2.0))
    other = 0.3 * 0.3 / (0.3 + 0.7 * math.exp(-1.0))
    assert expected_share(shares, ratio)[0] == pytest.approx(one + other)
    assert expected_share(shares, np.zeros((1, 2, 2)))[0] == pytest.approx(0.7**2 + 0.3**2)


def tracks_of(
    at: int,
    poses: Array,
    shares: tuple[float, ...] = (0.5, 0.5),
    frame: str = "map",
    state: State = STATE_AMBIGUOUS,
) -> Tracks:
    tracks = [
        Track(id=i + 1, pose=to_message(pose), probability=share)
        for i, (pose, share) in enumerate(zip(poses, shares, strict=True))
    ]
    return Tracks(timestamp=stamp(at), frame_id=frame, tracks=tracks, state=state)


def advisor(at: int = S) -> Advisor:
    made = Advisor(ProjectorSettings(robot_radius=RADIUS, advice_reach=REACH))
    made.see({"robot": "r", "lidar": "front"}, at, AROUND)
    return made


def test_it_is_published_once_a_second_by_the_stamps() -> None:
    site, made = building(CUPBOARD), advisor()
    at = [S + i * S // 10 for i in range(25)]
    published = []
    for each in at:
        made.see({"robot": "r", "lidar": "front"}, each, AROUND)
        published.append(made.receive("r", tracks_of(each, TWO.poses), site) is not None)
    assert [i for i, there in enumerate(published) if there] == [0, 9, 18]


@pytest.mark.parametrize("state", [STATE_LOCALIZED, STATE_LOST, STATE_UNSPECIFIED])
def test_there_is_none_while_the_pose_is_not_ambiguous(state: State) -> None:
    site, made = building(CUPBOARD), advisor()
    assert made.receive("r", tracks_of(S, TWO.poses, state=state), site) is None


def test_what_it_states() -> None:
    site, made = building(CUPBOARD), advisor()
    advice = made.receive("r", tracks_of(S, TWO.poses, (0.6, 0.3)), site)
    assert advice is not None
    assert advice.kind == Advice.KIND_MOVE
    assert list(advice.track_ids) == [1, 2]
    assert advice.probability_now == pytest.approx((2 / 3) ** 2 + (1 / 3) ** 2)
    assert advice.probability > 0.85
    assert (advice.frame_id, advice.reach) == ("map", REACH)
    assert advice.timestamp == stamp(S)


def test_like_places_are_reported_as_such() -> None:
    site, made = building(), advisor()
    advice = made.receive("r", tracks_of(S, TWO.poses), site)
    assert advice is not None
    assert advice.kind == Advice.KIND_NOTHING
    assert (advice.heading, advice.distance, len(advice.track_ids)) == (0.0, 0.0, 2)


def test_no_advice_without_two_places_a_lidar_or_the_maps_frame() -> None:
    site = building(CUPBOARD)
    for made, tracks in (
        (advisor(), tracks_of(S, TWO.poses, (0.95, 0.01))),
        (advisor(), tracks_of(S, np.array([START, (START[0] + 0.2, *START[1:])]))),
        (advisor(), tracks_of(S, TWO.poses, frame="elsewhere")),
        (advisor(at=10 * S), tracks_of(S, TWO.poses)),
        (advisor(), tracks_of(S, np.full((2, 3), math.nan))),
        (advisor(), Tracks(timestamp=stamp(S), frame_id="map", state=STATE_AMBIGUOUS)),
    ):
        assert made.receive("r", tracks, site) is None


def test_lidars_that_are_gone_make_room_for_others() -> None:
    """After four names that were used once, a robot was never advised again."""
    site, made = building(CUPBOARD), advisor()
    for number in range(MOST_LIDARS):
        made.see({"robot": "r", "lidar": f"old{number}"}, S, AROUND)
    made.see({"robot": "r", "lidar": "new"}, 9 * S, AROUND)
    assert made.receive("r", tracks_of(9 * S, TWO.poses), site) is not None


def test_tracks_near_each_other_are_one_place_and_the_faint_ones_none() -> None:
    poses = np.array([(0.0, 0.0, 3.1), (0.1, 0.1, -3.1), *((10.0 * i, 5.0, 0.0) for i in range(1, 9))])
    shares = (0.2, 0.2, *(0.07,) * 8)
    places = Places.of(tracks_of(S, poses, shares))
    assert len(places.tracks) == MOST_PLACES
    assert places.tracks[0] == 1
    assert places.shares.sum() == pytest.approx(1.0)
    assert places.shares[0] > 0.4


def test_of_tracks_without_end_the_most_probable_ones_count() -> None:
    count = 4 * MOST_TRACKS
    poses = np.column_stack([10.0 * np.arange(count), np.zeros(count), np.zeros(count)])
    places = Places.of(tracks_of(S, poses, (*(1e-4,) * (count - 2), 0.4, 0.5)))
    assert places.tracks == (count, count - 1)
    assert places.shares.sum() == pytest.approx(1.0)


def test_places_off_the_map_do_no_harm() -> None:
    far = np.array([START, (5e3, -7e3, 1.0)])
    assert best_move(building(CUPBOARD), [AROUND], Places(far, TWO.shares, (1, 2)), RADIUS, REACH) is None


def test_the_core_publishes_it_on_its_channel_and_counts_it() -> None:
    core, off = ready(), ready(advice=False)
    poses = free_poses(2, 3)
    messages = [
        Envelope(SCAN, ADDRESS, scan_at(poses[0], time=S)),
        Envelope(TRACKS, ADDRESS, tracks_of(S, poses)),
    ]
    published = [answer for message in messages for answer in core.handle(message)]
    (advice,) = (answer for answer in published if answer.channel is ADVICE)
    assert advice.key == "s/robot/r/advice/robot"
    counted = core.condition().counters
    assert counted.get("advised", 0) + counted.get("advised_nothing", 0) == 1
    assert not [a for m in messages for a in off.handle(m) if a.channel is ADVICE]
