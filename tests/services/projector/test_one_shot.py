"""A query about one scan: candidates, probabilities, none of these, what is known besides, bad input."""

from __future__ import annotations

import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from eigenscan.eigenspace.floors import Floor
from eigenscan.geometry.pose import compose, from_message, inverse
from eigenscan.geometry.pose import to_message as pose_message
from eigenscan.projector.channels import LOCALIZE_ANSWERED, LOCALIZE_ASKED, LOCALIZE_REFUSED
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import MODEL_SET, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.localize_pb2 import LocalizeQuery, LocalizeReply
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from google.protobuf.wrappers_pb2 import StringValue

from tests.services.projector.office import (
    ADDRESS,
    Array,
    envelopes,
    free_poses,
    ready,
    scan_at,
    site,
    tower,
)

MOUNT = (0.3, -0.1, 0.5)


@pytest.fixture(scope="module")
def core() -> ProjectorCore:
    return ready()


def raw(scan: Scan) -> RawScan:
    return RawScan(
        timestamp=scan.timestamp,
        mount=scan.mount,
        angle_min=scan.angle_min,
        angle_increment=scan.angle_increment,
        range_min=scan.range_min,
        range_max=scan.range_max,
        ranges=scan.ranges,
    )


def output(core: ProjectorCore, query: LocalizeQuery) -> Envelope:
    (only,) = core.handle(Envelope(LOCALIZE_ASKED, {"query": "7"}, query))
    assert only.address == {"query": "7"}
    return only


def ask(core: ProjectorCore, pose: Array, **known: object) -> LocalizeReply:
    """What is answered to a whole turn of a lidar on `MOUNT` of a base at `pose`."""
    scan = scan_at(compose(pose, MOUNT), field_of_view=2 * np.pi, mount=MOUNT)
    envelope = output(core, LocalizeQuery(scan=raw(scan), **known))  # type: ignore[arg-type]
    assert envelope.channel is LOCALIZE_ANSWERED
    return envelope.open(LocalizeReply)


def refusal(core: ProjectorCore, query: LocalizeQuery) -> str:
    envelope = output(core, query)
    assert envelope.channel is LOCALIZE_REFUSED
    return envelope.open(StringValue).value


def bases(count: int, seed: int) -> Array:
    return compose(free_poses(count, seed), inverse(MOUNT))


def is_near(pose: Pose2, truth: Array) -> bool:
    return bool(np.hypot(*(from_message(pose) - truth)[:2]) < 0.3)


def test_the_first_candidate_is_where_the_scan_was_taken_and_all_sums_to_one(core: ProjectorCore) -> None:
    right, sure = [], []
    for truth in bases(12, 3):
        reply = ask(core, truth)
        total = sum(one.probability for one in reply.candidates) + reply.none_probability
        assert total == pytest.approx(1.0, abs=1e-6)
        likelihoods = [one.log_likelihood for one in reply.candidates]
        assert likelihoods == sorted(likelihoods, reverse=True)
        right.append(is_near(reply.candidates[0].pose, truth))
        sure.append(reply.candidates[0].probability)
    assert np.mean(right) > 0.9
    assert np.median(sure) > 0.9


def test_it_is_the_answer_that_a_robots_scan_gets(core: ProjectorCore) -> None:
    scan = scan_at(free_poses(1, 11)[0])
    ordinary = next(iter(core.handle(Envelope(SCAN, ADDRESS, scan)))).open(Hypotheses)
    asked = output(core, LocalizeQuery(scan=raw(scan))).open(LocalizeReply)
    assert [one.pose for one in asked.candidates] == [one.pose for one in ordinary.hypotheses]
    assert [one.log_likelihood for one in asked.candidates] == [
        one.log_likelihood for one in ordinary.hypotheses
    ]
    assert asked.searched_area_m2 == asked.asked_area_m2 == ordinary.searched_area_m2
    assert (asked.frame_id, asked.model_version) == (ordinary.frame_id, ordinary.model_version)


def test_a_scan_of_another_building_is_at_none_of_these(core: ProjectorCore) -> None:
    none = []
    for pose in free_poses(8, 5, tower()):
        query = LocalizeQuery(scan=raw(scan_at(pose, grid=tower(), field_of_view=2 * np.pi)))
        none.append(output(core, query).open(LocalizeReply).none_probability)
    assert np.median(none) > 0.5


def test_what_is_known_leaves_out_other_places(core: ProjectorCore) -> None:
    for truth in bases(4, 21):
        near = ask(core, truth, near=pose_message(truth), radius=1.0, turn=0.5)
        assert is_near(near.candidates[0].pose, truth)
        for one in near.candidates:
            off = from_message(one.pose) - truth
            assert np.hypot(*off[:2]) <= 1.0
            assert abs(math.remainder(off[2], 2 * math.pi)) <= 0.5
        assert near.asked_area_m2 <= math.pi
        region = near.candidates[0].region
        inside = ask(core, truth, region=region)
        assert {one.region for one in inside.candidates} == {region}


def test_a_sensor_far_from_the_base_is_found_where_the_base_is_known(core: ProjectorCore) -> None:
    """On a long vehicle: regions near its base were searched, and the sensor was in another one."""
    mount = (7.0, 0.0, 0.0)
    for sensor in free_poses(8, 22):
        truth = compose(sensor, inverse(mount))
        scan = raw(scan_at(sensor, field_of_view=2 * np.pi, mount=mount))
        query = LocalizeQuery(scan=scan, near=pose_message(truth), radius=0.5, turn=0.5)
        reply = output(core, query).open(LocalizeReply)
        assert is_near(reply.candidates[0].pose, truth)


def test_a_wrong_prior_is_answered_by_none_of_these(core: ProjectorCore) -> None:
    none = []
    for truth in bases(8, 31):
        whole = ask(core, truth)
        away = max(bases(40, 32), key=lambda pose: float(np.hypot(*(pose - truth)[:2])))
        reply = ask(core, truth, near=pose_message(away), radius=1.0)
        assert not any(is_near(one.pose, truth) for one in reply.candidates)
        none.append(reply.none_probability)
        assert whole.none_probability < 0.5
    assert np.median(none) > 0.9


def test_a_floor_is_reported_and_asked_for() -> None:
    """The office's left and right half as two floors, the right one with a frame of its own."""
    origin = np.array([5.0, 2.0, math.pi / 2])

    def half(name: str, own: Array, x0: float, x1: float) -> ModelSet.Floor:
        corners = np.array([[x0, 2.0], [x1, 2.0], [x1, 13.0], [x0, 13.0]])
        return Floor(name, own, corners).to_message()

    core = ProjectorCore(ProjectorSettings())
    for envelope in envelopes(site()):
        if envelope.channel is MODEL_SET:
            floors = [half("left", np.zeros(3), -3.0, 5.0), half("right", origin, 5.0, 13.0)]
            message = envelope.open(ModelSet)
            del message.floors[:]
            message.floors.extend([*floors, ModelSet.Floor(name="broken")])
        core.handle(envelope)
    truth = next(pose for pose in bases(50, 41) if pose[0] > 7.0)
    best = ask(core, truth).candidates[0]
    assert best.floor == "right"
    assert np.allclose(compose(origin, from_message(best.floor_pose)), from_message(best.pose))
    there = ask(core, truth, floor="right", near=best.floor_pose, radius=0.5)
    assert is_near(there.candidates[0].pose, truth)
    elsewhere = ask(core, truth, floor="left")
    assert {one.floor for one in elsewhere.candidates} <= {"left"}
    assert elsewhere.none_probability > 0.5
    scan = raw(scan_at(truth))
    assert refusal(core, LocalizeQuery(scan=scan, floor="attic")).startswith(
        "floor: 'attic' is not of this map"
    )


def test_at_most_so_many_candidates_are_listed_and_the_others_are_none(core: ProjectorCore) -> None:
    truth = bases(1, 51)[0]
    every, two = ask(core, truth), ask(core, truth, most=2)
    assert len(every.candidates) > 2
    assert list(two.candidates) == list(every.candidates)[:2]
    rest = sum(one.probability for one in every.candidates[2:])
    assert two.none_probability == pytest.approx(every.none_probability + rest, abs=1e-9)


def test_too_few_beams_are_distinguished_from_no_place(core: ProjectorCore) -> None:
    scan = raw(scan_at(free_poses(1, 1)[0]))
    scan.ranges[5:] = [math.inf] * (len(scan.ranges) - 5)
    reply = output(core, LocalizeQuery(scan=scan)).open(LocalizeReply)
    assert reply.status == Hypotheses.STATUS_UNUSABLE_SCAN
    assert not reply.candidates
    assert reply.none_probability == 1.0


def _change(**fields: object) -> Callable[[LocalizeQuery], None]:
    def change(query: LocalizeQuery) -> None:
        for name, value in fields.items():
            if name == "ranges":
                del query.scan.ranges[:]
                query.scan.ranges.extend(value)  # type: ignore[arg-type]
            else:
                setattr(query.scan, name, value)

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda query: query.ClearField("scan"), "scan.ranges: no beams"),
        (_change(ranges=[math.nan] * 181), "scan.ranges: none lies between range_min and"),
        (_change(ranges=[1.0] * 16_385), "scan.ranges: more than 16384"),
        (_change(ranges=np.linspace(500.0, 9000.0, 181)), "scan.ranges: must be metres"),
        (_change(ranges=[0.3] * 181), "scan.ranges: all have one value: is the lidar covered?"),
        (_change(angle_min=math.nan), "scan.angle_min"),
        (_change(angle_increment=0.0), "scan.angle_increment: must not be 0"),
        (_change(angle_increment=1.0), "scan.angle_increment: the beams cover over one turn"),
        (_change(ranges=[1.0], angle_increment=4.0), "scan.angle_increment: .* over half a turn apart"),
        (
            _change(ranges=[1.0, 2.0], angle_increment=-3.15),
            "scan.angle_increment: .* over half a turn apart",
        ),
        (_change(range_min=9.0, range_max=5.0), "scan.range_min, range_max"),
        (_change(range_max=math.nan), "scan.range_min, range_max"),
        (lambda query: query.scan.mount.CopyFrom(Pose2(x=math.inf)), "scan.mount"),
        (lambda query: query.scan.mount.CopyFrom(Pose2(y=-1e300)), "scan.mount: not finite, or over 100 m"),
        (lambda query: query.near.CopyFrom(Pose2(x=math.nan)), "near: not finite"),
        (lambda query: query.near.CopyFrom(Pose2()), "radius: 0.0 m"),
        (lambda query: query.MergeFrom(LocalizeQuery(near=Pose2(), radius=math.nan)), "radius: nan m"),
        (
            lambda query: query.MergeFrom(LocalizeQuery(near=Pose2(), radius=math.inf)),
            "radius: inf m; must be finite",
        ),
        (lambda query: query.MergeFrom(LocalizeQuery(radius=2.0)), "near: missing"),
        (lambda query: query.MergeFrom(LocalizeQuery(near=Pose2(), radius=1.0, turn=-1.0)), "turn: -1.0"),
        (lambda query: query.MergeFrom(LocalizeQuery(region="nowhere")), "region: 'nowhere'"),
        (
            lambda query: query.MergeFrom(LocalizeQuery(region="n" * 12_000)),
            "region: 'n{79} is none of the",
        ),
        (
            lambda query: query.MergeFrom(LocalizeQuery(floor="n" * 12_000)),
            "floor: 'n{79} is not of this map",
        ),
        (lambda query: query.MergeFrom(LocalizeQuery(floor="first")), "floor: 'first' .* it has no floors$"),
        (
            lambda query: query.MergeFrom(LocalizeQuery(near=Pose2(x=9e5), radius=1.0)),
            r"near, radius, floor, region: no part of the map",
        ),
    ],
)
def test_what_is_wrong_is_named_by_its_field_and_changes_nothing(
    core: ProjectorCore, change: Callable[[LocalizeQuery], None], words: str
) -> None:
    query = LocalizeQuery(scan=raw(scan_at(free_poses(1, 2)[0])))
    before = output(core, query).open(LocalizeReply)
    bad = LocalizeQuery()
    bad.CopyFrom(query)
    change(bad)
    counted = core.condition().counters.get("queries_refused", 0)
    assert re.match(words, refusal(core, bad))
    assert core.condition().counters["queries_refused"] == counted + 1
    assert output(core, query).open(LocalizeReply) == before


@pytest.mark.parametrize("least_beams", [1, 12])
def test_beams_half_a_turn_apart_are_answered(least_beams: int) -> None:
    """The fewest beams that a whole turn may have."""
    core = ready(least_beams=least_beams)
    for ranges in ([1.0], [1.0, 2.0], [1.0, 2.0, 1.0]):
        scan = RawScan(ranges=ranges, angle_min=-1.0, angle_increment=math.pi, range_max=30.0)
        reply = output(core, LocalizeQuery(scan=scan)).open(LocalizeReply)
        assert (reply.status == Hypotheses.STATUS_OK) is (least_beams == 1)


def test_without_a_model_it_reports_what_is_missing() -> None:
    core = ProjectorCore(ProjectorSettings())
    assert refusal(core, LocalizeQuery(scan=raw(scan_at(free_poses(1, 2)[0])))) == "no answer yet: no model"


def test_queries_with_any_number_of_lidars_leave_a_robots_own_tables_alone() -> None:
    core = ready()
    pose = free_poses(1, 8)[0]
    list(core.handle(Envelope(SCAN, ADDRESS, scan_at(pose))))
    assert core._site is not None
    (own,) = core._site.sensors
    kept = core._site.view(own)
    for number in range(12):
        scan = raw(scan_at(pose, range_max=8.0 + number))
        assert output(core, LocalizeQuery(scan=scan)).channel is LOCALIZE_ANSWERED
    assert core._site.has_view(own)
    assert core._site.view(own) is kept
    assert core._site.sensors == [own]
