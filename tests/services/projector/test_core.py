"""What the projector publishes, and what it makes of messages that are late, foreign or broken."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from eigenscan.eigenspace.floors import Floor
from eigenscan.eigenspace.model import model_set
from eigenscan.geometry.gridmap import to_message
from eigenscan.geometry.pose import compose
from eigenscan.projector.channels import LOCALIZE_ASKED
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.publishing import obstacles_message
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL, MODEL_SET, OBSTACLES, SCAN, SPACE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles
from eigenscan.schemas.localize_pb2 import LocalizeQuery, LocalizeReply
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel, RegionSpace
from eigenscan.schemas.scan_pb2 import RawScan, Scan

from tests.services.projector.office import (
    ADDRESS,
    base_of,
    envelopes,
    free_poses,
    is_right,
    occlude,
    office,
    poses_of,
    ready,
    receive,
    scan_at,
    site,
    tower,
)


@pytest.fixture(scope="module")
def core() -> ProjectorCore:
    return ready()


def _copy(message: RegionModel) -> RegionModel:
    other = RegionModel()
    other.CopyFrom(message)
    return other


def test_without_a_model_it_waits_and_publishes_nothing() -> None:
    core = ProjectorCore(ProjectorSettings())
    assert core.condition().status == Health.STATUS_WAITING
    assert core.condition().detail == "no model"
    assert list(core.handle(Envelope(SCAN, ADDRESS, scan_at(free_poses(1, 0)[0])))) == []
    assert core.condition().counters["scan_without_model"] == 1


@pytest.mark.parametrize("seed", range(4))
def test_a_set_is_taken_whole_in_any_order(seed: int) -> None:
    core = ProjectorCore(ProjectorSettings())
    received = envelopes(site())
    np.random.default_rng(seed).shuffle(received)
    scan = scan_at(free_poses(1, 1)[0])
    for envelope in received:
        assert core.condition().status == Health.STATUS_WAITING
        assert list(core.handle(Envelope(SCAN, ADDRESS, scan))) == []
        core.handle(envelope)
    assert core.condition().status == Health.STATUS_OK
    message, _ = receive(core, scan)
    assert message.model_version == site().to_message().version


@pytest.mark.parametrize(
    ("field_of_view", "step", "range_max"),
    [
        (180, 1, 30),
        (180, 0.25, 80),
        (240, 0.36, 5.6),
        (270, 0.5, 30),
        (360, 1, 12),
        (360, 2, 30),
        (200, 1.7, 20),
        (180, 2, 10),
        (240, 0.5, 4),
        (270, 0.25, 100),
        (360, 0.5, 4),
    ],
)
def test_every_lidar_finds_its_place(
    core: ProjectorCore, field_of_view: float, step: float, range_max: float
) -> None:
    first = listed = 0
    for i, truth in enumerate(free_poses(25, 7)):
        scan = scan_at(
            truth, field_of_view=np.deg2rad(field_of_view), step=np.deg2rad(step), range_max=range_max, seed=i
        )
        right = is_right(poses_of(receive(core, scan)[0]), truth)
        first += bool(right[0])
        listed += bool(right.any())
    assert first >= 20
    assert listed >= 22


def test_poses_are_the_robots_base_and_lie_where_the_mount_states(core: ProjectorCore) -> None:
    mount = (0.4, -0.2, 2.0)
    found = 0
    for i, truth in enumerate(free_poses(10, 21)):
        message, obstacles = receive(core, scan_at(truth, field_of_view=2 * np.pi, mount=mount, seed=i))
        base = base_of(truth, mount)
        pose = poses_of(message)[0]
        found += bool(np.allclose(pose[:2], base[:2], atol=0.1) and is_right(pose[None], base)[0])
        assert obstacles is not None
        assert np.allclose([obstacles.pose.x, obstacles.pose.y, obstacles.pose.theta], pose)
    assert found >= 9


def test_each_answer_states_how_its_scan_was_gathered(core: ProjectorCore) -> None:
    scan = scan_at(free_poses(1, 4)[0], field_of_view=2 * np.pi)
    scan.gathered = 3.0
    for few in (False, True):
        if few:
            scan.ranges[5:] = [float("nan")] * (len(scan.ranges) - 5)
        assert receive(core, scan)[0].gathered == 3.0


def test_covariances_match_the_errors(core: ProjectorCore) -> None:
    squares = []
    for i, truth in enumerate(free_poses(60, 31)):
        message, _ = receive(core, scan_at(truth, field_of_view=np.deg2rad(270), noise=0.03, seed=i))
        if not is_right(poses_of(message)[:1], truth)[0]:
            continue
        c = message.hypotheses[0].covariance
        covariance = np.array([[c.xx, c.xy, c.xt], [c.xy, c.yy, c.yt], [c.xt, c.yt, c.tt]])
        error = poses_of(message)[0] - truth
        error[2] = (error[2] + np.pi) % (2 * np.pi) - np.pi
        assert np.all(np.linalg.eigvalsh(covariance) > 0)
        squares.append(error @ np.linalg.solve(covariance, error))
    assert len(squares) >= 50
    # on a perfect map the error is below what real maps need; never above its three degrees of freedom
    assert np.mean(squares) < 4.0
    assert np.quantile(squares, 0.95) < 10.0


def test_people_in_front_of_the_sensor_cost_little(core: ProjectorCore) -> None:
    plain = hidden = listed = 0
    for i, truth in enumerate(free_poses(60, 41)):
        scan = scan_at(truth, seed=i)
        plain += bool(is_right(poses_of(receive(core, scan)[0])[:1], truth)[0])
        right = is_right(poses_of(receive(core, occlude(scan, 0.3, i))[0]), truth)
        hidden += bool(right[0])
        listed += bool(right.any())
    assert plain >= 54
    assert hidden >= 0.8 * plain
    assert listed >= 0.9 * plain


def test_another_building_and_a_covered_lidar_are_not_squeezed_in(core: ProjectorCore) -> None:
    own, foreign = [], []
    for i in range(25):
        wide = np.deg2rad(270)
        own.append(receive(core, scan_at(free_poses(25, 51)[i], field_of_view=wide, seed=i))[0])
        elsewhere = scan_at(free_poses(25, 52, tower())[i], grid=tower(), field_of_view=wide, seed=i)
        foreign.append(receive(core, elsewhere)[0])

    def best(messages: list[Hypotheses]) -> np.ndarray:
        return np.array([m.hypotheses[0].log_likelihood for m in messages])

    # a prior of one place among e^13 needs as many nats to be overcome
    assert np.median(best(own)) > 13.0
    assert best(foreign).max() < 13.0
    covered = scan_at(free_poses(1, 53)[0])
    covered.ranges[:] = (0.12 + 0.01 * np.random.default_rng(0).normal(size=len(covered.ranges))).tolist()
    message, _ = receive(core, covered)
    assert message.status == Hypotheses.STATUS_UNUSABLE_SCAN


def test_unlisted_is_never_likelier_than_listed(core: ProjectorCore) -> None:
    for i, truth in enumerate(free_poses(10, 61)):
        message, _ = receive(core, scan_at(truth, seed=i))
        values = [h.log_likelihood for h in message.hypotheses]
        assert values == sorted(values, reverse=True)
        assert len(values) <= 30
        assert message.unlisted_log_likelihood <= min(0.0, values[-1])


def test_each_lidar_of_each_robot_is_answered_on_its_own_key() -> None:
    core = ready(instance="7")
    scan = scan_at(free_poses(1, 71)[0])
    output = list(core.handle(Envelope(SCAN, {"site": "s", "robot": "r9", "lidar": "rear"}, scan)))
    assert [e.channel for e in output] == [HYPOTHESES, OBSTACLES]
    assert output[0].key == "s/robot/r9/hypotheses/rear/7"
    assert output[1].key == "s/robot/r9/obstacles/rear/7"


def test_hypotheses_are_on_their_way_before_obstacles_are_looked_for(
    core: ProjectorCore, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked = list[str]()

    def noted(*given: Any) -> Obstacles:
        looked.append("obstacles")
        return obstacles_message(*given)

    monkeypatch.setattr("eigenscan.projector.core.obstacles_message", noted)
    answers = iter(core.handle(Envelope(SCAN, ADDRESS, scan_at(free_poses(1, 3)[0]))))
    assert next(answers).channel is HYPOTHESES
    assert not looked
    assert next(answers).channel is OBSTACLES
    assert looked == ["obstacles"]


def test_the_same_scan_has_the_same_answer_bit_for_bit() -> None:
    scan = scan_at(free_poses(1, 72)[0])
    other = scan_at(free_poses(1, 73)[0], field_of_view=2 * np.pi)
    one, two = ready(), ready()
    receive(two, other)
    assert receive(one, scan)[0].SerializeToString() == receive(two, scan)[0].SerializeToString()


@pytest.mark.parametrize("usable", [True, False])
def test_the_scans_motion_goes_on_with_its_hypotheses(core: ProjectorCore, usable: bool) -> None:
    scan = scan_at(free_poses(1, 74)[0])
    if not usable:
        scan.ranges[:] = [np.nan] * len(scan.ranges)
    assert not receive(core, scan)[0].HasField("motion")
    scan.motion.motion.theta = 0.25
    assert receive(core, scan)[0].motion == scan.motion


@pytest.mark.parametrize("degrees", [7.5, 30.0, 32.7, 60.0])
def test_a_scan_of_fewer_than_twelve_beams_is_unusable_however_far_they_are_apart(
    core: ProjectorCore, degrees: float
) -> None:
    scan = scan_at(free_poses(1, 4)[0], field_of_view=2 * np.pi, step=np.deg2rad(degrees))
    message, _ = receive(core, scan)
    assert (message.status == Hypotheses.STATUS_OK) is (len(scan.ranges) >= 12)
    fields = {name: getattr(scan, name) for name in ("angle_min", "angle_increment", "range_max", "ranges")}
    asked = LocalizeQuery(scan=RawScan(**fields))
    (answered,) = core.handle(Envelope(LOCALIZE_ASKED, {"query": "1"}, asked))
    assert answered.open(LocalizeReply).status == message.status


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_scan_without_returns_is_unusable(core: ProjectorCore, value: float) -> None:
    scan = scan_at(free_poses(1, 0)[0])
    scan.ranges[:] = [value] * len(scan.ranges)
    message, obstacles = receive(core, scan)
    assert message.status == Hypotheses.STATUS_UNUSABLE_SCAN
    assert not message.hypotheses
    assert obstacles is None


@pytest.mark.parametrize("mount", [101.0, 1e308, np.nan])
def test_a_mount_farther_than_a_robot_is_large_makes_no_sense(mount: float) -> None:
    core = ready()
    scan = scan_at(free_poses(1, 0)[0])
    scan.mount.x = mount
    assert list(core.handle(Envelope(SCAN, ADDRESS, scan))) == []
    assert core.condition().counters["scan_malformed"] == 1


@pytest.mark.parametrize("far", [1e6, 3e38])
@pytest.mark.parametrize("share", [0.1, 0.5])
def test_ranges_that_no_lidar_has_count_as_no_return(core: ProjectorCore, far: float, share: float) -> None:
    scan, empty = (scan_at(free_poses(1, 0)[0]) for _ in range(2))
    some = np.random.default_rng(0).random(len(scan.ranges)) < share
    for one, value in ((scan, far), (empty, np.inf)):
        one.range_max = 0.0
        one.ranges[:] = np.where(some, value, one.ranges)
    assert receive(core, scan)[0].hypotheses == receive(core, empty)[0].hypotheses


@pytest.mark.parametrize(
    "change",
    [
        {"angle_increment": 0.0},
        {"angle_increment": float("nan")},
        {"angle_increment": -0.01},
        {"angle_min": float("inf")},
        {"angle_min": 1e300},
        {"range_max": float("nan")},
        {"range_max": -1.0},
    ],
)
def test_a_scan_that_makes_no_sense_is_counted(change: dict[str, float]) -> None:
    core = ready()
    scan = scan_at(free_poses(1, 0)[0])
    for name, value in change.items():
        setattr(scan, name, value)
    assert list(core.handle(Envelope(SCAN, ADDRESS, scan))) == []
    assert list(core.handle(Envelope(SCAN, ADDRESS, Scan()))) == []
    assert core.condition().counters["scan_malformed"] == 2


def _broken(change: str) -> list[Envelope]:
    """A newer set of which one region cannot be used."""
    received = envelopes(site(of="tower"))
    model = _copy(next(e for e in received if e.channel == MODEL).open(RegionModel))
    if change == "format":
        model.format += 1
    elif change == "bytes":
        model.panoramas = model.panoramas[: len(model.panoramas) // 2]
    elif change == "content":
        model.spacing += 0.1
    elif change == "empty":
        del model.index_x[:], model.index_y[:]
    rest = [e for e in received if e.channel != MODEL or e.open(RegionModel).region != model.region]
    return [*rest, Envelope(MODEL, {"site": "s", "region": model.region}, model)]


@pytest.mark.parametrize("change", ["format", "bytes", "content", "empty"])
def test_a_broken_model_is_refused_by_name_and_the_last_good_one_stays(change: str) -> None:
    core = ready()
    truth = free_poses(1, 81)[0]
    before = receive(core, scan_at(truth, field_of_view=2 * np.pi))[0]
    for envelope in _broken(change):
        core.handle(envelope)
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "region" in condition.detail
    assert condition.counters["refused_model"] == 1
    after = receive(core, scan_at(truth, field_of_view=2 * np.pi))[0]
    assert after.SerializeToString() == before.SerializeToString()


def test_regions_on_different_grids_are_refused_by_name_and_the_last_good_set_stays() -> None:
    core = ready()
    truth = free_poses(1, 82)[0]
    before = receive(core, scan_at(truth, field_of_view=2 * np.pi))[0]
    coarse, fine = site(of="tower"), site(0.25)
    mixed = [replace(coarse.regions[0], region="coarse"), replace(fine.regions[0], region="fine")]
    announced = model_set(mixed, coarse.grid.version, "map", 100.0)
    for envelope in (
        Envelope(MAP, {"site": "s"}, to_message(coarse.grid, "map")),
        *(Envelope(MODEL, {"site": "s", "region": m.region}, m.to_message()) for m in mixed),
        Envelope(MODEL_SET, {"site": "s"}, announced),
    ):
        core.handle(envelope)
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "'fine'" in condition.detail
    after = receive(core, scan_at(truth, field_of_view=2 * np.pi))[0]
    assert after.SerializeToString() == before.SerializeToString()
    # and the next good one is taken
    for envelope in envelopes(site(of="tower")):
        core.handle(envelope)
    assert core.condition().status == Health.STATUS_OK
    assert receive(core, scan_at(truth))[0].model_version == site(of="tower").to_message().version


@pytest.mark.parametrize("change", ["bytes", "resolution", "pose"])
def test_a_broken_map_is_refused_and_the_last_good_set_stays(change: str) -> None:
    core = ready()
    truth = free_poses(1, 83)[0]
    before = receive(core, scan_at(truth))[0]
    for envelope in envelopes(site(of="tower")):
        message = envelope.message
        if envelope.channel == MAP:
            message = to_message(tower(), "map")
            if change == "bytes":
                message.data = message.data[:-5]
            elif change == "resolution":
                message.cell_size.x = 0.0
            else:
                message.pose.orientation.z = float("nan")
        core.handle(Envelope(envelope.channel, envelope.address, message))
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert condition.counters["refused_map"] == 1
    assert receive(core, scan_at(truth))[0].SerializeToString() == before.SerializeToString()


def test_a_set_that_is_not_what_its_version_states_is_refused() -> None:
    core = ready()
    foreign = ModelSet(version="0" * 64, map_version="1", entries=[ModelSet.Entry(region="r", version="2")])
    for message in (foreign, ModelSet(version="1")):
        core.handle(Envelope(MODEL_SET, {"site": "s"}, message))
    assert core.condition().counters["refused_model_set"] == 2
    assert receive(core, scan_at(free_poses(1, 0)[0]))[0].model_version == site().to_message().version


def test_a_floors_frame_that_moved_is_taken_although_the_version_is_the_same() -> None:
    """It was the old one until a restart: the version covers maps and regions only."""
    outline = np.array([[-100.0, -100.0], [100.0, -100.0], [100.0, 100.0], [-100.0, 100.0]])
    before, after = (replace(site(), floors=(Floor("1", np.array([x, 0.0, 0.0]), outline),)) for x in (0, 5))
    assert before.to_message().version == after.to_message().version
    core, scan = ready(before), scan_at(free_poses(1, 84)[0])
    query = LocalizeQuery(
        scan=RawScan(
            ranges=list(scan.ranges),
            angle_min=scan.angle_min,
            angle_increment=scan.angle_increment,
            range_max=scan.range_max,
        )
    )

    def answers() -> tuple[bytes, float]:
        hypotheses = receive(core, scan)[0].SerializeToString()
        (answered,) = core.handle(Envelope(LOCALIZE_ASKED, {"query": "1"}, query))
        first = answered.open(LocalizeReply).candidates[0]
        return hypotheses, first.pose.x - first.floor_pose.x

    old, shift = answers()
    assert shift == pytest.approx(0.0)
    announced = after.to_message()
    core.handle(Envelope(MODEL_SET, {"site": "s"}, announced))
    new, shift = answers()
    assert shift == pytest.approx(5.0)
    assert new == old
    # the same again, of another time, is no new one
    used = core._site
    announced.timestamp.seconds = 7
    core.handle(Envelope(MODEL_SET, {"site": "s"}, announced))
    assert core._site is used


def test_health_is_ok_again_once_what_was_refused_is_mended() -> None:
    """It stayed degraded until another set, although the one in use is what was announced last."""
    core = ready()
    torn = to_message(site().grid, "map")
    torn.data = torn.data[:-5]
    for refused in (
        Envelope(MAP, {"site": "s"}, torn),
        Envelope(MODEL_SET, {"site": "s"}, ModelSet(version="1")),
        Envelope(
            SPACE, {"site": "s", "region": "r", "kind": "k"}, RegionSpace(region="r", model_version="1")
        ),
    ):
        core.handle(refused)
        assert core.condition().status == Health.STATUS_DEGRADED
        for envelope in envelopes(site()):
            core.handle(envelope)
        assert core.condition().status == Health.STATUS_OK


def test_a_part_that_is_empty_stays_named_while_the_last_set_is_used() -> None:
    core = ready(part="2/2")
    for _ in range(2):
        for envelope in envelopes(site(of="tower")):
            core.handle(envelope)
        assert core.condition().status == Health.STATUS_DEGRADED
        assert core.condition().detail.startswith("part 2/2: the set has only 1 regions")


@pytest.mark.parametrize("first", ["before a set", "beside a set"])
def test_a_map_waits_for_its_set_while_another_one_comes(first: str) -> None:
    """Of two mapbuilders, or of one that publishes its map again: the set then lacked its map for good."""
    core = ready() if first == "beside a set" else ProjectorCore(ProjectorSettings())
    tower_map, *rest = envelopes(site(of="tower"))
    core.handle(tower_map)
    core.handle(envelopes(site())[0])
    for envelope in rest:
        core.handle(envelope)
    assert core.condition().status == Health.STATUS_OK
    assert (
        receive(core, scan_at(free_poses(1, 0)[0]))[0].model_version == site(of="tower").to_message().version
    )


def test_maps_without_a_set_are_bounded() -> None:
    core = ready()
    for shift in range(1, 6):
        grid = replace(office(), origin=np.array([float(shift), 0.0, 0.0]))
        core.handle(Envelope(MAP, {"site": "s"}, to_message(grid, "map")))
    assert len(core._assembler._grids) == 3
    assert site().grid.version in core._assembler._grids


@pytest.mark.parametrize("area", [0.0, -5.0, np.nan, np.inf, 1e300, 1e4])
def test_a_set_whose_area_is_none_of_its_map_is_refused(area: float) -> None:
    """Infinite, each scan raised an error; 0, a pose that was nowhere had a probability of 0.95."""
    core = ready()
    *parts, last = envelopes(site(of="tower"))
    announced = last.open(ModelSet)
    announced.free_area_m2 = area
    for envelope in (*parts, last):
        core.handle(envelope)
    condition = core.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert condition.detail.startswith("model set: free_area_m2 = ")
    assert receive(core, scan_at(free_poses(1, 85)[0]))[0].model_version == site().to_message().version


def test_a_new_set_takes_over_between_two_scans() -> None:
    core = ready()
    truth = free_poses(1, 91, tower())[0]
    scan = scan_at(truth, grid=tower(), field_of_view=2 * np.pi)
    versions = []
    for envelope in envelopes(site(of="tower")):
        versions.append(receive(core, scan)[0].model_version)
        core.handle(envelope)
    old, new = site().to_message().version, site(of="tower").to_message().version
    assert set(versions) == {old}
    message, _ = receive(core, scan)
    assert message.model_version == new
    assert is_right(poses_of(message)[:1], truth)[0]


def test_plain_ranges_as_in_the_paper_work_too() -> None:
    core = ready(site(embedding="range"))
    found = sum(
        bool(is_right(poses_of(receive(core, scan_at(truth, seed=i))[0])[:1], truth)[0])
        for i, truth in enumerate(free_poses(20, 101))
    )
    assert found >= 14


def test_obstacles_are_found_where_they_are(core: ProjectorCore) -> None:
    hits = masked = hidden = 0
    for i, truth in enumerate(free_poses(20, 111)):
        scan = scan_at(truth, field_of_view=2 * np.pi, seed=i)
        blocked = occlude(scan, 0.15, i)
        message, obstacles = receive(core, blocked)
        if not is_right(poses_of(message)[:1], truth)[0]:
            continue
        assert obstacles is not None
        before, after = np.array(scan.ranges), np.array(blocked.ranges)
        real = np.isfinite(after) & (before - after > 0.5)
        mask = np.frombuffer(obstacles.mask, dtype=np.uint8)
        hits += int(np.count_nonzero(real & (mask == 0)))
        masked += int(np.count_nonzero(mask == 0))
        hidden += int(np.count_nonzero(real))
        assert len(obstacles.sensor_x) == len(obstacles.map_x) == np.count_nonzero(mask == 0)
        points = np.column_stack([obstacles.sensor_x, obstacles.sensor_y, np.zeros(len(obstacles.sensor_x))])
        pose = np.array([obstacles.pose.x, obstacles.pose.y, obstacles.pose.theta])
        assert np.allclose(
            compose(pose, points)[:, :2], np.column_stack([obstacles.map_x, obstacles.map_y]), atol=1e-3
        )
    assert hits >= 0.95 * hidden
    assert hits >= 0.9 * masked


def test_missing_beams_are_marked_missing(core: ProjectorCore) -> None:
    scan = scan_at(free_poses(1, 121)[0])
    scan.ranges[3] = np.nan
    scan.ranges[4] = np.inf
    _, obstacles = receive(core, scan)
    assert obstacles is not None
    assert obstacles.mask[3] == 255
    assert obstacles.mask[4] == 255
    assert np.isnan(obstacles.error[3])
    assert len(obstacles.mask) == len(scan.ranges) == len(obstacles.error)


def test_office_is_what_the_tests_think(core: ProjectorCore) -> None:
    assert 90 < office().free_area < 160
    assert core.condition().status == Health.STATUS_OK
