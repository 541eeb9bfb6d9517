"""The field by field comparison, against the wire: it must find a difference exactly where bytes differ."""

import math
from typing import Any

import pytest
from eigenscan.schemas.channels import HYPOTHESES, OBSTACLES, POSE, SCAN, SCAN_MOTION, TRACKS, TRANSFORM
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, STATE_LOST, PoseEstimate, Track, Tracks
from eigenscan.schemas.wire import encode
from eigenscan.workbench.replay.fields import TOLERANCES, Difference, differences
from hypothesis import given
from hypothesis import strategies as st

# protobuf keeps nothing of a NaN's payload that a test should rest on
numbers = st.floats(allow_nan=False)
near = st.sampled_from([0.0, -0.0, 1.0, math.nextafter(1.0, 2.0), math.inf])
poses = st.builds(Pose2, x=near, y=near, theta=numbers)
tracks = st.builds(
    Track, id=st.integers(0, 3), pose=st.none() | poses, probability=near, history=st.lists(poses, max_size=2)
)
messages = st.builds(Tracks, frame_id=st.sampled_from(["", "map"]), tracks=st.lists(tracks, max_size=2))


@given(messages, messages)
def test_fields_differ_where_bytes_do(a: Tracks, b: Tracks) -> None:
    assert bool(list(differences(a, b))) == (encode(a) != encode(b))


@given(messages)
def test_nothing_differs_from_itself(a: Tracks) -> None:
    assert not list(differences(a, a))
    assert not list(differences(a, a, tolerant=True))


def test_a_path_leads_to_the_field() -> None:
    one = Hypotheses(hypotheses=[Hypothesis(), Hypothesis(pose=Pose2(x=1.0), region="r1")])
    other = Hypotheses(hypotheses=[Hypothesis(), Hypothesis(pose=Pose2(x=2.0), region="r2")])
    found = list(differences(one, other))
    assert found == [
        Difference("hypotheses[1].pose.x", 1.0, 2.0),
        Difference("hypotheses[1].region", "r1", "r2"),
    ]
    assert found[0].name == "hypotheses.pose.x"


def test_enums_are_named_and_what_is_absent_is_called_so() -> None:
    one = PoseEstimate(state=STATE_LOST, pose=Pose2(x=1.0))
    other = PoseEstimate(state=STATE_LOCALIZED)
    assert list(differences(one, other)) == [
        Difference("pose", "x: 1", "(absent)"),
        Difference("state", "STATE_LOST", "STATE_LOCALIZED"),
    ]


def test_missing_beams_are_alike_and_unlike_empty_ones() -> None:
    nan, inf = math.nan, math.inf
    assert not list(differences(Scan(ranges=[nan, inf]), Scan(ranges=[nan, inf])))
    (found,) = differences(Scan(ranges=[nan, 1.0]), Scan(ranges=[inf, 1.0]), tolerant=True)
    assert found.path == "ranges[0]"


@pytest.mark.parametrize(("field", "tolerance"), [("x", 1e-5), ("theta", 1e-5)])
def test_within_tolerance_and_beyond(field: str, tolerance: float) -> None:
    one = PoseEstimate(pose=Pose2(**{field: 1.0}))
    for part, expected in ((0.5, 0), (2.0, 1)):
        other = PoseEstimate(pose=Pose2(**{field: 1.0 + part * tolerance}))
        assert len(list(differences(one, other, tolerant=True))) == expected
        assert len(list(differences(one, other))) == 1


def test_headings_are_near_across_the_turn() -> None:
    one, other = (PoseEstimate(pose=Pose2(theta=sign * (math.pi - 1e-7))) for sign in (1, -1))
    assert not list(differences(one, other, tolerant=True))
    assert len(list(differences(one, other))) == 1


def test_the_table_names_fields_that_exist() -> None:
    """And each published float has a tolerance, so that no processor's last bit fails a replay."""
    floats: set[tuple[str, ...]] = set()
    names: set[str] = set()

    def visit(message: Any, around: tuple[str, ...]) -> None:
        for field in message.fields:
            names.add(field.name)
            if field.message_type is not None:
                visit(field.message_type, (*around, field.name))
            elif field.cpp_type in {field.CPPTYPE_DOUBLE, field.CPPTYPE_FLOAT}:
                floats.add((*around, field.name))

    for channel in (SCAN, SCAN_MOTION, HYPOTHESES, OBSTACLES, POSE, TRACKS, TRANSFORM):
        visit(channel.message.DESCRIPTOR, ())
    assert TOLERANCES.keys() <= names
    # copied, never computed from a scan
    stated = {
        "range_min",
        "range_max",
        "searched_area_m2",
        "protection_risk",
        "longest_step",
        "gathered",
        "factor",
        "offset",
        "apart",
    }
    bare = {path for path in floats if not set(path) & TOLERANCES.keys()}
    assert {path[-1] for path in bare} == stated
