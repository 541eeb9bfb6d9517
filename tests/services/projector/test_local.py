"""A projector that is asked for one place fits the scan there, and searches the whole map where it must."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message, inverse, to_message
from eigenscan.projector.core import ProjectorCore
from eigenscan.schemas.channels import HYPOTHESES, OBSTACLES, SCAN, SEARCH
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.hypotheses_pb2 import (
    SEARCH_LOCAL,
    SEARCH_UNSPECIFIED,
    SEARCH_WHOLE,
    Hypotheses,
    SearchRequest,
)
from eigenscan.workbench.conformance.values import faults

from tests.services.projector.office import (
    ADDRESS,
    envelopes,
    free_poses,
    is_right,
    ready,
    receive,
    scan_at,
    site,
)

START = 10**15
STEP = 100_000_000
FULL = 2 * np.pi
SURE = Covariance3(xx=0.01, yy=0.01, tt=0.001)
MOUNT = (0.3, -0.1, 0.7)
NOWHERE = -1e6
"""A likelihood that every fit reaches."""
STEEPEST = 33.0 * 3.0 * math.sqrt(3.0) / (8.0 * 0.15)
"""Nats a metre: by how much a beam's support, half at 0.15 m from a wall, changes at most where it ends."""
FARTHEST = 16.0
"""m: no beam in the office is longer."""


def request(place: np.ndarray, time: int, **change: Any) -> SearchRequest:
    fields: dict[str, Any] = {
        "timestamp": stamp(time),
        "frame_id": "map",
        "search": SEARCH_LOCAL,
        "pose": to_message(place),
        "covariance": SURE,
        "least_log_likelihood": NOWHERE,
    }
    return SearchRequest(**{**fields, **change})


def ask(core: ProjectorCore, wanted: SearchRequest, **address: str) -> None:
    assert list(core.handle(Envelope(SEARCH, {**ADDRESS, **address}, wanted))) == []


def scan(truth: np.ndarray, time: int, seed: int = 0) -> Any:
    """What a lidar at MOUNT of a base at `truth` sees."""
    return scan_at(compose(truth, MOUNT), field_of_view=FULL, mount=MOUNT, seed=seed, time=time)


def after(truth: np.ndarray, *requests: SearchRequest, core: ProjectorCore | None = None) -> Hypotheses:
    """The second answer to a robot that stands, with requests in between."""
    core = core or ready()
    receive(core, scan(truth, START))
    for wanted in requests:
        ask(core, wanted)
    return receive(core, scan(truth, START + STEP))[0]


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """Base poses (n, 3) at which the whole search's best is right, and away from others."""
    core = ready()
    sensors = free_poses(30, 171)
    truths = compose(sensors, inverse(np.array(MOUNT)))
    right = []
    for i, truth in enumerate(truths):
        listed = receive(core, scan(truth, START + i))[0].hypotheses
        right.append(bool(is_right(from_message(listed[0].pose), truth)))
    assert np.mean(right) > 0.8
    return np.asarray(truths[np.array(right)])


def test_where_the_whole_search_is_right_the_local_fit_gives_the_same(places: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    core = ready()
    for i, truth in enumerate(places):
        begin = START + i * 10**10
        whole = receive(core, scan(truth, begin))[0]
        off = rng.uniform(-1.0, 1.0, 3) * [0.15, 0.15, 0.1]
        ask(core, request(truth + off, begin))
        local, obstacles = receive(core, scan(truth, begin + STEP))
        assert (whole.search, local.search) == (SEARCH_WHOLE, SEARCH_LOCAL)
        (found,), best = local.hypotheses, whole.hypotheses[0]
        x, y, turn = from_message(found.pose) - from_message(best.pose)
        apart, turned = float(np.hypot(x, y)), abs(math.remainder(turn, math.tau))
        assert apart < 0.01
        assert turned < np.deg2rad(0.4)
        # the same scan has the same ordinary place, so only a pose that differs tells another likelihood
        assert abs(found.log_likelihood - best.log_likelihood) < 1e-3 + STEEPEST * (apart + FARTHEST * turned)
        assert found.covariance.xx == pytest.approx(best.covariance.xx, rel=0.1)
        assert obstacles is not None
        assert list(faults(local)) == []


def test_a_local_answer_omits_other_places(places: np.ndarray) -> None:
    local = after(places[0], request(places[0], START))
    assert local.search == SEARCH_LOCAL
    assert len(local.hypotheses) == 1
    assert local.unlisted_log_likelihood == 0.0
    assert 0.0 < local.searched_area_m2 < 1.0
    assert not local.projections


def test_a_moving_robot_is_predicted_by_its_velocity(places: np.ndarray) -> None:
    core, before = ready(), places[1]
    velocity = np.array([1.5, 0.2, 1.0])
    receive(core, scan(before, START))
    ask(core, request(before, START, velocity=to_message(velocity)))
    now = compose(before, velocity * STEP * 1e-9)
    local = receive(core, scan(now, START + STEP))[0]
    assert local.search == SEARCH_LOCAL
    off = from_message(local.hypotheses[0].pose) - now
    assert np.hypot(off[0], off[1]) < 0.05


def whole(*bases: np.ndarray, **change: Any) -> SearchRequest:
    """For the whole map, and at these base poses."""
    listed = [to_message(each) for each in bases]
    return SearchRequest(timestamp=stamp(START), frame_id="map", search=SEARCH_WHOLE, places=listed, **change)


def likelihood_there(listed: Hypotheses, truth: np.ndarray) -> float:
    """Of the likeliest hypothesis at a base pose; -inf without one."""
    own = [
        each.log_likelihood for each in listed.hypotheses if is_right(from_message(each.pose), truth).all()
    ]
    return max(own, default=-math.inf)


@pytest.fixture
def blind(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search that looks at hardly any place."""
    monkeypatch.setattr("eigenscan.projector.projection.POLISHED", 1)


@pytest.mark.usefixtures("blind")
def test_a_whole_search_also_looks_where_it_is_asked_to(places: np.ndarray) -> None:
    def few() -> ProjectorCore:
        return ready(published=4, refined=2, candidates=2)

    off = np.array([0.1, -0.1, 0.05])
    missed = [each for each in places if likelihood_there(after(each, core=few()), each) == -math.inf]
    assert missed
    for truth in missed:
        found = after(truth, whole(places[0], truth + off), core=few())
        assert found.search == SEARCH_WHOLE
        assert likelihood_there(found, truth) > 10.0
        assert list(faults(found)) == []


def test_places_move_with_the_robot(places: np.ndarray) -> None:
    velocity = np.array([4.0, 0.0, 2.0])
    core, truth = ready(published=1, refined=2, candidates=2), places[2]
    started = compose(truth, inverse(velocity * STEP * 1e-9))
    found = after(truth, whole(started, velocity=to_message(velocity)), core=core)
    assert likelihood_there(found, truth) > 10.0


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e300, -1e9, 5e6])
def test_places_that_are_none_are_left_out(places: np.ndarray, bad: float) -> None:
    asked = whole(places[0] + [bad, 0.0, 0.0], *([places[0]] * 500))
    found, alone = after(places[0], asked), after(places[0])
    assert list(faults(found)) == []
    assert likelihood_there(found, places[0]) == pytest.approx(likelihood_there(alone, places[0]), abs=0.1)


def test_a_robot_that_is_elsewhere_is_searched_for_in_the_whole_map(places: np.ndarray) -> None:
    core, whole = ready(), ready()
    receive(core, scan(places[0], START))
    least = receive(whole, scan(places[0], START))[0].hypotheses[0].log_likelihood - 5.0
    for i, elsewhere in enumerate(places[1:8]):
        time = START + (i + 1) * STEP
        ask(core, request(places[0], time - STEP, least_log_likelihood=least))
        carried, plain = (receive(one, scan(elsewhere, time))[0] for one in (core, whole))
        assert carried == plain
        assert carried.search == SEARCH_WHOLE
    assert core.condition().counters["local_fit_lost"] == 7


def test_a_fit_that_ends_farther_off_than_a_place_is_lost(places: np.ndarray) -> None:
    moved = places[2] + np.array([0.6, 0.0, 0.0])
    assert after(places[2], request(moved, START)).search == SEARCH_WHOLE


@pytest.mark.parametrize(
    "change",
    [
        {"timestamp": stamp(START - STEP)},  # of an earlier scan
        {"timestamp": stamp(START + STEP)},  # of the scan itself
        {"timestamp": stamp(START + 2 * STEP)},  # of the future
        {"frame_id": "another"},
        {"search": SEARCH_WHOLE},
        {"search": SEARCH_UNSPECIFIED},
        {"least_log_likelihood": math.nan},
        {"least_log_likelihood": math.inf},
        {"least_log_likelihood": 1e3},
        {"pose": Pose2(x=math.nan)},
        {"pose": Pose2(theta=math.inf)},
        {"pose": Pose2(x=1e300, y=-1e300)},
        {"velocity": Pose2(x=math.inf)},
        {"velocity": Pose2(x=1e308)},
        {"velocity": Pose2(theta=math.nan)},
        {"covariance": Covariance3()},
        {"covariance": Covariance3(xx=math.nan, yy=0.01, tt=0.001)},
        {"covariance": Covariance3(xx=-1.0, yy=0.01, tt=0.001)},
        {"covariance": Covariance3(xx=0.01, yy=0.01, tt=-0.001)},
        {"covariance": Covariance3(xx=1e300, yy=0.01, tt=0.001)},
        {"covariance": Covariance3(xx=0.01, yy=0.01, tt=math.inf)},
    ],
)
def test_what_asks_for_no_place_brings_the_whole_search(places: np.ndarray, change: dict[str, Any]) -> None:
    with_it, without = after(places[0], request(places[0], START, **change)), after(places[0])
    assert with_it == without
    assert with_it.search == SEARCH_WHOLE


def test_a_request_that_comes_late_changes_nothing_any_more(places: np.ndarray) -> None:
    core = ready()
    receive(core, scan(places[0], START))
    assert receive(core, scan(places[0], START + STEP))[0].search == SEARCH_WHOLE
    ask(core, request(places[0], START))
    assert receive(core, scan(places[0], START + 2 * STEP))[0].search == SEARCH_WHOLE


def test_the_newest_request_of_a_stamp_counts_and_each_lidar_has_its_own(places: np.ndarray) -> None:
    local, whole = request(places[0], START), request(places[0], START, search=SEARCH_WHOLE)
    assert after(places[0], local, whole).search == SEARCH_WHOLE
    assert after(places[0], whole, local).search == SEARCH_LOCAL
    core = ready()
    ask(core, local, lidar="rear")
    ask(core, local, robot="another")
    assert after(places[0], core=core).search == SEARCH_WHOLE


@pytest.mark.parametrize(("apart", "search"), [(500_000_000, SEARCH_LOCAL), (500_000_001, SEARCH_WHOLE)])
def test_after_a_long_gap_the_whole_map_is_searched(places: np.ndarray, apart: int, search: int) -> None:
    core = ready()
    receive(core, scan(places[0], START))
    ask(core, request(places[0], START))
    assert receive(core, scan(places[0], START + apart))[0].search == search


def test_without_a_recent_whole_search_none_is_left_out(places: np.ndarray) -> None:
    core, searches = ready(), []
    for i in range(45):
        searches.append(receive(core, scan(places[0], START + i * STEP))[0].search)
        ask(core, request(places[0], START + i * STEP))
    # its measure of an ordinary place is two seconds old at most
    assert [i for i, one in enumerate(searches) if one == SEARCH_WHOLE] == [0, 21, 42]


def test_a_new_map_begins_again(places: np.ndarray) -> None:
    core = ready()
    receive(core, scan(places[0], START))
    ask(core, request(places[0], START))
    for envelope in envelopes(site(spacing=1.0, components=4)):
        list(core.handle(envelope))
    assert receive(core, scan(places[0], START + STEP))[0].search == SEARCH_WHOLE


@pytest.mark.parametrize(
    "settings", [{"part": "1/2"}, {"verification": "eigenspace"}, {"obstacles": "reconstruction"}]
)
def test_who_cannot_fit_searches_all_that_it_has(places: np.ndarray, settings: dict[str, Any]) -> None:
    core = ready(**settings)
    assert after(places[0], request(places[0], START), core=core).search == SEARCH_WHOLE


def test_an_unusable_scan_is_no_scan_before(places: np.ndarray) -> None:
    core = ready()
    receive(core, scan(places[0], START))
    blind = scan(places[0], START + STEP)
    blind.ranges[:] = [math.nan] * len(blind.ranges)
    assert receive(core, blind)[0].status == Hypotheses.STATUS_UNUSABLE_SCAN
    ask(core, request(places[0], START + STEP))
    assert receive(core, scan(places[0], START + 2 * STEP))[0].search == SEARCH_WHOLE


def test_a_local_answer_has_both_messages_at_the_scans_time(places: np.ndarray) -> None:
    core = ready()
    receive(core, scan(places[0], START))
    ask(core, request(places[0], START))
    published = list(core.handle(Envelope(SCAN, ADDRESS, scan(places[0], START + STEP))))
    assert [one.channel for one in published] == [HYPOTHESES, OBSTACLES]
    assert {one.stamp for one in published} == {START + STEP}
