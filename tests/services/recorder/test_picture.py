"""What is drawn, read back from the .rrd file: the right things, at the right places and times."""

from __future__ import annotations

import itertools
import math
import random
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pyarrow as pa
import pytest
import rerun.blueprint as rrb
from eigenscan.eigenspace.analysis import Analysis
from eigenscan.eigenspace.embedding import CIRCUMFERENCE, Embedding, Kind
from eigenscan.eigenspace.model import RegionModel, quantize
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.gridmap import to_message as grid_message
from eigenscan.geometry.pose import compose, inverse, to_message, to_pose3
from eigenscan.recorder import rerun_sink
from eigenscan.recorder.background_sink import BackgroundSink
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.picture import curves, status
from eigenscan.recorder.picture.belief import probabilities
from eigenscan.recorder.picture.blueprint import blueprint
from eigenscan.recorder.picture.board import ASPECT, MOST_BARS, Line, draw_board, shown
from eigenscan.recorder.picture.canvas import Pace
from eigenscan.recorder.picture.floor import scale_length
from eigenscan.recorder.picture.layout import Layout
from eigenscan.recorder.picture.manifold import Manifold, analysis_of
from eigenscan.recorder.picture.palette import AMBIGUOUS, LOCALIZED, LOST, percent
from eigenscan.recorder.picture.robot import label_place
from eigenscan.recorder.picture.shapes import MAHALANOBIS_95, arrows, ellipse
from eigenscan.recorder.rerun_sink import RerunSink
from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.channels import (
    ADVICE,
    CHANNELS,
    HEALTH,
    HYPOTHESES,
    MAP,
    MODEL,
    MODEL_SET,
    POSE,
    SCAN,
    TRACKS,
    TRUTH,
)
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles, SearchRequest
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.model_pb2 import RegionModel as RegionModelMessage
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
    Relocation,
    State,
    Track,
    Tracks,
)
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import DecodeError
from hypothesis import given
from hypothesis import strategies as st
from rerun.chunk import RrdReader
from scipy.stats import chi2

from tests.services.recorder.traffic import Site

ADDRESS = {"site": "s", "robot": "r1", "lidar": "front"}
S = 1_000_000_000


def draw(
    path: Path,
    messages: Iterable[Envelope],
    picture_hz: float = 1000.0,
    layout: Layout = "operator",
    draw_all: bool = False,
) -> None:
    sink = RerunSink(RecorderOptions(rrd=path, picture_hz=picture_hz, layout=layout, draw_all=draw_all))
    for message in messages:
        sink.write(message)
    sink.close()


def rows(path: Path, entity: str, column: str) -> list[tuple[int | None, Any]]:
    """Time (ns, None for all times) and value of a component, in order of time."""
    found = []
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if chunk.entity_path == entity and column in batch.schema.names:
            times: list[int | None] = [None] * batch.num_rows
            if not chunk.is_static:
                times = batch.column("time").cast(pa.int64()).to_pylist()
            found += list(zip(times, batch.column(column).to_pylist(), strict=True))
    return sorted(found, key=lambda row: row[0] or 0)


def entities(path: Path) -> set[str]:
    return {chunk.entity_path for chunk in RrdReader(str(path)).stream()}


def test_the_file_is_sound_and_holds_every_part_of_the_picture(tmp_path: Path) -> None:
    path = tmp_path / "a.rrd"
    draw(path, Site("s", seconds=3.0).messages())
    result = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "verify", str(path)], capture_output=True, check=False
    )
    assert result.returncode == 0, result.stderr
    expected = {
        "/legend",
        "/status",
        "/state/r1",
        "/events/r1",
        "/events/tracker",
        "/belief/r1",
        "/error/position/r1",
        "/error/heading/r1",
        "/world/map",
        "/world/regions/hallway",
        "/world/robots/r1/pose",
        "/world/robots/r1/pose/label",
        "/world/robots/r1/pose/within_95_percent",
        "/world/scale",
        "/world/robots/r1/scan/front",
        "/world/robots/r1/hypotheses/front/0",
        "/world/robots/r1/tracks",
        "/world/robots/r1/obstacles/front",
        "/world/robots/r1/truth",
        "/world/robots/r1/advice",
        "/world/robots/r1/advice/label",
        "/beams/r1/front/explained",
        "/beams/r1/front/unexpected",
        "/eigenspace/r1/scan",
        "/eigenspace/r1/hypotheses",
        "/eigenspace/r1/places",
        "/eigenspace/r1/loop",
        "/curves/r1/scan/seen",
        "/curves/r1/scan/kept",
        "/curves/r1/eigenscans",
    }
    assert expected <= entities(path)
    assert len(RrdReader(str(path)).blueprints()) >= 1


def test_two_robots_share_one_map(tmp_path: Path) -> None:
    first = Site("s", "r1", seconds=1.0).messages()
    second = Site("s", "r2", seconds=1.0, seed=2).messages()
    draw(tmp_path / "a.rrd", [message for pair in zip(first, second, strict=False) for message in pair])
    drawn = entities(tmp_path / "a.rrd")
    assert {f"/world/robots/{robot}/tracks" for robot in ("r1", "r2")} <= drawn
    assert {f"/belief/{robot}" for robot in ("r1", "r2")} <= drawn
    assert len(rows(tmp_path / "a.rrd", "/world/map", "GridMap:data")) >= 1


def test_a_wall_is_drawn_where_it_is(tmp_path: Path) -> None:
    cells = np.full((4, 6), FREE, dtype=np.uint8)
    cells[1, 5] = OCCUPIED  # second row from the south, easternmost
    grid = GridMap(cells, 0.5, np.array([10.0, 20.0, math.pi / 2]))
    draw(tmp_path / "a.rrd", [Envelope(MAP, ADDRESS, grid_message(grid, "map"))])

    def only(component: str) -> Any:
        ((_, (value,)),) = rows(tmp_path / "a.rrd", "/world/map", f"GridMap:{component}")
        return value

    form = only("format")
    picture = np.array(only("data")).reshape(form["height"], form["width"])
    ((row, column),) = np.argwhere(picture == OCCUPIED)
    size = only("cell_size")
    # Rerun: the first row of the image is on top, `translation` is the lower left corner
    along, up = (column + 0.5) * size, (form["height"] - 1 - row + 0.5) * size
    turn, corner = only("rotation_axis_angle"), only("translation")
    assert turn["axis"] == [0.0, 0.0, 1.0]
    cos, sin = math.cos(turn["angle"]), math.sin(turn["angle"])
    centre = (corner[0] + cos * along - sin * up, corner[1] + sin * along + cos * up)
    assert centre == pytest.approx((10.0 - 0.75, 20.0 + 2.75), abs=1e-6)


UTM = (500_250.0, 5_400_750.0)


def moved(message: Envelope) -> Envelope:
    """The message as a robot sends it whose map lies at UTM."""
    body = deepcopy(message.message)
    places: list[Any] = []
    match body:
        case Grid() | PoseInFrame():
            places = [body.pose.position]
        case PoseEstimate() | SearchRequest() | Relocation():
            places = [body.pose]
        case Hypotheses():
            places = [each.pose for each in body.hypotheses]
        case Tracks():
            places = [pose for each in body.tracks for pose in (each.pose, *each.history)]
        case Obstacles():
            body.map_x[:] = [x + UTM[0] for x in body.map_x]
            body.map_y[:] = [y + UTM[1] for y in body.map_y]
        case RegionModelMessage():
            body.outline_x[:] = [x + UTM[0] for x in body.outline_x]
            body.outline_y[:] = [y + UTM[1] for y in body.outline_y]
    for place in places:
        place.x, place.y = place.x + UTM[0], place.y + UTM[1]
    return Envelope(message.channel, message.address, body)


def test_a_map_in_utm_coordinates_is_drawn_as_exactly_as_any(tmp_path: Path) -> None:
    messages = list(Site("s", "r1", seconds=6.0).messages())
    draw(tmp_path / "here.rrd", messages)
    draw(tmp_path / "utm.rrd", map(moved, messages))
    for entity in sorted(entities(tmp_path / "here.rrd")):
        if not entity.startswith("/world") or entity == "/world/scale":
            continue
        for column in ("GridMap:translation", "Points3D:positions", "LineStrips3D:strips"):
            here = rows(tmp_path / "here.rrd", entity, column)
            there = rows(tmp_path / "utm.rrd", entity, column)
            assert [at for at, _ in here] == [at for at, _ in there]
            for (_, one), (_, other) in zip(here, there, strict=True):
                for strip, shifted in zip(one or [], other or [], strict=True):
                    apart = np.atleast_2d(shifted)[:, :2] - np.atleast_2d(strip)[:, :2]
                    assert apart == pytest.approx(np.broadcast_to((250.0, 750.0), apart.shape), abs=1e-3)
    ((_, labels),) = rows(tmp_path / "utm.rrd", "/world/scale", "Points3D:labels")
    assert labels[0].endswith("x and y from (500000, 5400000)")


@pytest.mark.parametrize("is_first", [True, False])
def test_outlines_lie_on_the_map_wherever_it_is_and_whenever_it_comes(tmp_path: Path, is_first: bool) -> None:
    address, path = {"site": "s", "region": "hall"}, tmp_path / "utm.rrd"
    corners: dict[str, Any] = {
        "outline_x": [UTM[0], UTM[0] + 9.0, UTM[0]],
        "outline_y": [UTM[1], UTM[1], UTM[1] + 9.0],
    }
    models = ModelSet(version="v")
    models.floors.add(name="ground", **corners)
    outlines = [
        Envelope(MODEL, address, RegionModelMessage(region="hall", **corners)),
        Envelope(MODEL_SET, address, models),
    ]
    map_ = moved(next(m for m in Site("s", "r1", seconds=0.1).messages() if m.channel is MAP))
    draw(path, [*outlines, map_] if is_first else [map_, *outlines])
    for entity in ("/world/regions/hall", "/world/floors/ground"):
        drawn = [strips for _, strips in rows(path, entity, "LineStrips3D:strips")]
        assert any(np.allclose(strips[0][0][:2], (250.0, 750.0)) for strips in drawn)
        assert len(drawn) == 1 + is_first  # the later one replaces the other


def test_a_map_too_big_for_a_texture_keeps_its_walls_and_its_scale(tmp_path: Path) -> None:
    cells = np.full((9000, 3), FREE, dtype=np.uint8)
    cells[8000, 1] = OCCUPIED
    grid = GridMap(cells, 0.1, np.zeros(3))
    draw(tmp_path / "a.rrd", [Envelope(MAP, ADDRESS, grid_message(grid, "map"))])
    ((_, (form,)),) = rows(tmp_path / "a.rrd", "/world/map", "GridMap:format")
    ((_, (data,)),) = rows(tmp_path / "a.rrd", "/world/map", "GridMap:data")
    ((_, (size,)),) = rows(tmp_path / "a.rrd", "/world/map", "GridMap:cell_size")
    assert max(form["height"], form["width"]) <= 4096
    picture = np.array(data).reshape(form["height"], form["width"])
    ((row, _),) = np.argwhere(picture == OCCUPIED)
    south, north = (form["height"] - 1 - row) * size, (form["height"] - row) * size
    assert south <= 800.05 <= north


def ambiguous(at: int, pose: list[float], state: State = STATE_AMBIGUOUS) -> Envelope:
    return Envelope(
        POSE, ADDRESS, PoseEstimate(timestamp=stamp(at), pose=to_message(pose), state=state, track_id=1)
    )


def advised(at: int, **fields: Any) -> Envelope:
    return Envelope(ADVICE, ADDRESS, Advice(timestamp=stamp(at), track_ids=[1, 2], **fields))


def test_an_advised_move_is_an_arrow_as_long_as_it_with_words_at_its_tip(tmp_path: Path) -> None:
    pose = [4.0, -2.0, 0.5]
    move = {"kind": Advice.KIND_MOVE, "heading": 1.0, "distance": 3.0}
    draw(
        tmp_path / "a.rrd", [ambiguous(S, pose), advised(S, **move), ambiguous(2 * S, pose, STATE_LOCALIZED)]
    )
    drawn = rows(tmp_path / "a.rrd", "/world/robots/r1/advice", "LineStrips3D:strips")
    ((at, strips),) = [row for row in drawn if row[1]]
    corners = np.array([corner for strip in strips for corner in strip])
    tip = np.array(pose[:2]) + 3.0 * np.array([math.cos(1.5), math.sin(1.5)])
    away = np.hypot(*(corners[:, :2] - pose[:2]).T)
    assert at == S
    assert away.min() == pytest.approx(0.0, abs=1e-5)
    assert away.max() == pytest.approx(3.0, abs=1e-5)
    assert corners[np.argmax(away), :2] == pytest.approx(tip, abs=1e-5)
    label = "/world/robots/r1/advice/label"
    ((_, words),) = [row for row in rows(tmp_path / "a.rrd", label, "Points3D:labels") if row[1]]
    assert words == ["drive 3.0 m, 57° to the left, to distinguish 2 places"]
    # once the place is known there is none
    for path in ("/world/robots/r1/advice", label):
        assert [time for time, _ in rows(tmp_path / "a.rrd", path, "Clear:is_recursive")] == [2 * S]


@pytest.mark.parametrize(
    ("fields", "words", "length"),
    [
        ({"kind": Advice.KIND_NOTHING, "reach": 8.0}, "no move within 8 m distinguishes 2 places", None),
        ({"kind": Advice.KIND_MOVE, "heading": -1.0}, "turn 57° to the right to distinguish 2 places", 1.0),
        (
            {"kind": Advice.KIND_MOVE, "heading": 0.05, "distance": 1.25},
            "drive 1.2 m, straight ahead, to distinguish 2 places",
            1.25,
        ),
        (
            {"kind": Advice.KIND_MOVE, "heading": 3.1, "distance": 0.5},
            "drive 0.5 m, straight back, to distinguish 2 places",
            0.5,
        ),
    ],
)
def test_each_kind_of_advice(
    tmp_path: Path, fields: dict[str, Any], words: str, length: float | None
) -> None:
    draw(tmp_path / "a.rrd", [ambiguous(S, [0.0, 0.0, 0.0]), advised(S, **fields)])
    label = rows(tmp_path / "a.rrd", "/world/robots/r1/advice/label", "Points3D:labels")
    assert [row[1] for row in label if row[1]] == [[words]]
    strips = rows(tmp_path / "a.rrd", "/world/robots/r1/advice", "LineStrips3D:strips")
    if length is None:
        assert not strips
    else:
        ((_, drawn),) = strips
        reach = max(math.hypot(x, y) for strip in drawn for x, y, _ in strip)
        assert reach == pytest.approx(length, abs=1e-5)


def test_advice_without_a_place_or_with_impossible_numbers_is_not_drawn(tmp_path: Path) -> None:
    move = {"kind": Advice.KIND_MOVE, "heading": 0.0}
    lost = ambiguous(S, [0.0, 0.0, 0.0])
    lost.open(PoseEstimate).track_id = 0
    draw(tmp_path / "a.rrd", [lost, advised(S, **move, distance=1.0)])
    strange = [advised(S + i, **move, distance=value) for i, value in enumerate((math.nan, math.inf, 1e9))]
    draw(tmp_path / "b.rrd", [ambiguous(S, [0.0, 0.0, 0.0]), *strange, advised(S, distance=1.0)])
    for name in ("a.rrd", "b.rrd"):
        assert not any("advice" in entity for entity in entities(tmp_path / name))


def test_old_advice_goes(tmp_path: Path) -> None:
    move = advised(S, kind=Advice.KIND_MOVE, distance=1.0)
    pose = [0.0, 0.0, 0.0]
    draw(tmp_path / "a.rrd", [ambiguous(S, pose), move, ambiguous(3 * S, pose), ambiguous(5 * S, pose)])
    cleared = rows(tmp_path / "a.rrd", "/world/robots/r1/advice", "Clear:is_recursive")
    assert [time for time, _ in cleared] == [5 * S]


def one_scan() -> Scan:
    return Scan(
        timestamp=stamp(S),
        mount=to_message([0.3, -0.1, 0.7]),
        angle_min=-1.0,
        angle_increment=0.5,
        range_max=9.0,
        ranges=[2.0, math.inf, 3.0, math.nan, 1.5],
        sequence=1,
    )


def localized(at: int, pose: list[float]) -> Envelope:
    message = PoseEstimate(
        timestamp=stamp(at), pose=to_message(pose), state=STATE_LOCALIZED, confidence=0.9, track_id=1
    )
    return Envelope(POSE, ADDRESS, message)


@pytest.mark.parametrize("pose_comes_first", [False, True])
def test_the_scan_lies_where_the_pose_of_its_stamp_puts_it(tmp_path: Path, pose_comes_first: bool) -> None:
    base, scan = [4.0, -2.0, 2.0], one_scan()
    older = one_scan()
    older.timestamp.CopyFrom(stamp(S // 2))
    older.ranges[:] = [5.0] * 5
    messages = [Envelope(SCAN, ADDRESS, older), Envelope(SCAN, ADDRESS, scan), localized(S, base)]
    draw(tmp_path / "a.rrd", [messages[i] for i in ((0, 2, 1) if pose_comes_first else (0, 1, 2))])
    moment, points = rows(tmp_path / "a.rrd", "/world/robots/r1/scan/front", "Points3D:positions")[-1]
    assert moment == S
    expected = []
    for beam, reach in enumerate(scan.ranges):
        if math.isfinite(reach):
            bearing = scan.angle_min + beam * scan.angle_increment
            end = compose(
                compose(base, [0.3, -0.1, 0.7]), [reach * math.cos(bearing), reach * math.sin(bearing), 0]
            )
            expected.append(end[:2])
    assert np.array(points)[:, :2] == pytest.approx(np.array(expected), abs=1e-5)


@pytest.mark.parametrize("track", [0, 7], ids=["no track", "an improbable track"])
def test_a_lost_robot_is_not_drawn_anywhere(tmp_path: Path, track: int) -> None:
    lost = PoseEstimate(
        timestamp=stamp(2 * S), state=STATE_LOST, track_id=track, pose=to_message([3.0, 2.0, 0.0])
    )
    draw(
        tmp_path / "a.rrd",
        [Envelope(SCAN, ADDRESS, one_scan()), localized(S, [1.0, 1.0, 0.0]), Envelope(POSE, ADDRESS, lost)],
    )
    for entity in ("pose", "scan/front"):
        path = f"/world/robots/r1/{entity}"
        cleared = [moment for moment, _ in rows(tmp_path / "a.rrd", path, "Clear:is_recursive")]
        assert cleared == [2 * S]
    states = rows(tmp_path / "a.rrd", "/state/r1", "StateChange:state")
    assert states == [(S, ["LOCALIZED"]), (2 * S, ["LOST"])]


def test_the_error_is_the_distance_from_the_truth_of_the_same_moment(tmp_path: Path) -> None:
    """Truth at 10 Hz beside poses in between, some of which come before their truth."""
    messages, expected = [], {}
    for k in range(60):
        at = S + k * S // 10
        truth = [0.1 * k, 1.0, math.pi - 0.1 + 0.01 * k]
        messages.append(
            (at, Envelope(TRUTH, ADDRESS, PoseInFrame(timestamp=stamp(at), pose=to_pose3(truth))))
        )
        if k < 59:
            between = at + S // 40
            believed = [0.1 * (k + 0.25) + 0.3, 1.0 + 0.01 * k, math.pi - 0.1 + 0.01 * (k + 0.25) + 0.2]
            messages.append((between, localized(between, believed)))
            expected[between] = (math.hypot(0.3, 0.01 * k), math.degrees(0.2))
    late_truth = [message for _, message in messages if message.channel == TRUTH]
    poses = [message for _, message in messages if message.channel == POSE]
    for name, order in {
        "in time": [message for _, message in sorted(messages, key=lambda timed: timed[0])],
        "truth late": poses + late_truth,
    }.items():
        path = tmp_path / f"{name}.rrd"
        draw(path, order)
        for index, quantity in enumerate(("position", "heading")):
            plotted = dict(rows(path, f"/error/{quantity}/r1", "Scalars:scalars"))
            assert set(plotted) == set(expected), name
            for moment, errors in expected.items():
                assert plotted[moment][0] == pytest.approx(errors[index], abs=1e-6), name


def test_a_viewer_that_comes_after_hours_of_the_same_state_receives_it(tmp_path: Path) -> None:
    """Old rows are dropped from a live viewer's memory: state and bar must come again."""
    draw(tmp_path / "a.rrd", [localized(S * second, [1.0, 1.0, 0.0]) for second in range(1, 302)])
    for entity, column in (("/state/r1", "StateChange:state"), ("/status", "Image:buffer")):
        moments = [moment for moment, _ in rows(tmp_path / "a.rrd", entity, column)]
        assert moments[0] == S
        assert max(np.diff([*moments, 301 * S])) <= 60 * S
        assert len(moments) <= 16


def test_a_robot_that_publishes_nothing_any_more_is_not_shown_as_well(tmp_path: Path) -> None:
    """Health goes on at the services' clock, which is another than the log's."""
    clock = 1_000_000 * S

    def health(second: int) -> Envelope:
        message = Health(timestamp=stamp(clock + second * S), service="recorder")
        return Envelope(HEALTH, ADDRESS | {"service": "recorder", "instance": "0"}, message)

    reported = [health(0), localized(S, [1, 1, 0]), health(1), localized(2 * S, [1, 1, 0])]
    draw(
        tmp_path / "a.rrd",
        [*reported, *(health(second) for second in range(2, 10)), localized(9 * S, [1, 1, 0])],
    )
    states = rows(tmp_path / "a.rrd", "/state/r1", "StateChange:state")
    assert states == [(S, ["LOCALIZED"]), (2 * S, ["SILENT"]), (9 * S, ["LOCALIZED"])]


@pytest.mark.parametrize(("ahead", "set_back"), [(2000, 0), (0, 500)])
def test_a_robot_is_silent_by_one_clock_whatever_another_one_has(
    tmp_path: Path, ahead: int, set_back: int
) -> None:
    """A service whose clock is ahead for once, or this machine's own that is set back, in s."""

    def at(second: int, envelope: Envelope) -> Envelope:
        return replace(envelope, arrived=(1000 + second) * S)

    def health(second: int, ahead: int = 0) -> Envelope:
        message = Health(timestamp=stamp((1000 + second + ahead) * S), service="recorder")
        return at(second, Envelope(HEALTH, ADDRESS | {"service": "recorder", "instance": "0"}, message))

    before = [health(0), at(0, localized(S, [1, 1, 0])), health(1, ahead)]
    after = [at(1, localized(2 * S, [1, 1, 0])), *(health(second - set_back) for second in range(2, 10))]
    draw(tmp_path / "a.rrd", [*before, *after])
    states = rows(tmp_path / "a.rrd", "/state/r1", "StateChange:state")
    assert states == [(S, ["LOCALIZED"]), (2 * S, ["SILENT"])]


def test_a_robot_with_scans_but_without_a_pose_is_shown_as_waiting(tmp_path: Path) -> None:
    """After three seconds: a start that goes well does not show it."""
    scans = [Envelope(SCAN, ADDRESS, Scan(timestamp=stamp(S + k * S // 2))) for k in range(20)]
    draw(tmp_path / "a.rrd", [*scans, localized(11 * S, [1, 1, 0])])
    states = rows(tmp_path / "a.rrd", "/state/r1", "StateChange:state")
    assert states == [(S + 7 * S // 2, ["WAITING"]), (11 * S, ["LOCALIZED"])]
    draw(tmp_path / "b.rrd", [*scans[:6], localized(5 * S, [1, 1, 0]), *scans[10:]])
    assert rows(tmp_path / "b.rrd", "/state/r1", "StateChange:state") == [(5 * S, ["LOCALIZED"])]


def test_only_hypotheses_in_play_are_drawn(tmp_path: Path) -> None:
    """Those within a hundredth of the best one, also where an unlisted place is likelier than all of them."""
    message = Hypotheses(timestamp=stamp(S), unlisted_log_likelihood=50.0)
    for x, likelihood in ((1.0, 10.0), (2.0, 9.0), (3.0, 4.0), (4.0, -5.0)):
        message.hypotheses.add(log_likelihood=likelihood, pose=to_message(np.array([x, 0.0, 0.0])))
    draw(tmp_path / "a.rrd", [Envelope(HYPOTHESES, ADDRESS | {"projector": "0"}, message)])
    ((_, strips),) = rows(tmp_path / "a.rrd", "/world/robots/r1/hypotheses/front/0", "LineStrips3D:strips")
    assert [strip[0][0] for strip in strips] == [1.0, 2.0]


def test_the_eigenspace_is_drawn_where_regions_change_between_its_pictures(tmp_path: Path) -> None:
    """It takes two scans in a row in one region. Its pictures are a second apart here."""
    messages = list(Site("s", seconds=6.0).messages())
    for message in messages:
        if message.channel == HYPOTHESES:
            received = message.open(Hypotheses)
            if nanoseconds(received.timestamp) // S % 2:
                for hypothesis in received.hypotheses:
                    hypothesis.region = "elsewhere"
    draw(tmp_path / "a.rrd", messages, picture_hz=5.0)
    assert rows(tmp_path / "a.rrd", "/eigenspace/r1/scan", "Points3D:positions")


def test_the_protection_level_is_a_circle_of_its_radius(tmp_path: Path) -> None:
    """It goes with the claim; a radius that is no number is not drawn."""
    messages = [localized(second * S, [3.0, 4.0, 1.0]) for second in (1, 2, 3)]
    messages[0].open(PoseEstimate).protection_radius = 0.7
    messages[2].open(PoseEstimate).protection_radius = math.inf
    draw(tmp_path / "a.rrd", messages)
    ((moment, strips),) = [
        (at, found)
        for at, found in rows(
            tmp_path / "a.rrd", "/world/robots/r1/pose/protection_level", "LineStrips3D:strips"
        )
        if found
    ]
    assert moment == S
    assert np.hypot(*(np.array(strips[0])[:, :2] - [3.0, 4.0]).T) == pytest.approx(0.7, abs=1e-5)


@pytest.mark.parametrize(
    ("state", "colour"),
    [(STATE_LOCALIZED, LOCALIZED), (STATE_AMBIGUOUS, AMBIGUOUS)],
    ids=["sure", "not sure"],
)
def test_map_and_board_show_one_state(tmp_path: Path, state: State, colour: tuple[int, int, int]) -> None:
    pose = localized(S, [1.0, 2.0, 0.0])
    pose.open(PoseEstimate).state = state
    draw(tmp_path / "a.rrd", [pose])
    for part in ("pose", "pose/label", "pose/within_95_percent"):
        kind = "LineStrips3D" if part != "pose/label" else "Points3D"
        ((_, packed),) = rows(tmp_path / "a.rrd", f"/world/robots/r1/{part}", f"{kind}:colors")
        assert tuple(packed[0].to_bytes(4, "big")[:3]) == colour
    _, board = rows(tmp_path / "a.rrd", "/status", "Image:buffer")[-1]
    shown = {tuple(pixel) for pixel in np.array(board[0]).reshape(-1, 3).tolist()}
    assert shown & {LOCALIZED, AMBIGUOUS, LOST} == {colour}


def test_label_and_board_state_one_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one pose the board stated 20 % and the label 38 %."""
    stated: list[str] = []

    def noted(lines: list[Line]) -> object:
        stated.extend(line.sureness for line in lines)
        return draw_board(lines)

    monkeypatch.setattr(status, "draw_board", noted)
    pose = localized(S, [1.0, 2.0, 0.0])
    pose.open(PoseEstimate).confidence = 0.389
    draw(tmp_path / "a.rrd", [pose])
    ((_, labels),) = rows(tmp_path / "a.rrd", "/world/robots/r1/pose/label", "Points3D:labels")
    assert "38%" in labels[0]
    assert stated == ["over 35 % sure"]


def test_the_board_shows_every_robot(tmp_path: Path) -> None:
    """A robot whose line changes all the time does not keep another's off the board."""
    other = ADDRESS | {"robot": "r2"}
    messages = []
    for tenth in range(10, 150):
        at = tenth * S // 10
        messages.append(localized(at, [1, 1, 0]))
        messages[-1].open(PoseEstimate).confidence = (tenth % 7) / 7
        if tenth % 2:
            calm = PoseEstimate(
                timestamp=stamp(at + 1),
                state=STATE_LOCALIZED,
                confidence=0.5 if tenth < 40 else 0.9,
                track_id=1,
            )
            messages.append(Envelope(POSE, other, calm))
    draw(tmp_path / "a.rrd", messages)
    boards = rows(tmp_path / "a.rrd", "/status", "Image:buffer")
    moments = [moment or 0 for moment, _ in boards]
    second = [np.array(pixels[0]).reshape(2, -1)[1].tobytes() for _, pixels in boards[1:]]
    changed = [moment for moment, a, b in zip(moments[2:], second, second[1:], strict=False) if a != b]
    assert len(changed) == 1
    assert 4 * S <= changed[0] <= 6.2 * S


def test_only_tracks_in_play_are_drawn(tmp_path: Path) -> None:
    address = {"site": "s", "robot": "r1"}
    drawn = []
    for number, shares in enumerate(((0.6, 0.3, 0.005), (0.004, 0.003))):  # then none of them is likely
        tracks = [
            Track(id=1 + i, pose=to_message((i, 2.0, 0.0)), probability=p) for i, p in enumerate(shares)
        ]
        drawn.append(Envelope(TRACKS, address, Tracks(timestamp=stamp((1 + number) * S), tracks=tracks)))
    draw(tmp_path / "a.rrd", drawn)
    points = rows(tmp_path / "a.rrd", "/world/robots/r1/tracks", "Points3D:positions")
    assert [sorted(x for x, _, _ in there or []) for _, there in points] == [[0.0, 1.0], []]


def test_every_pose_is_plotted_however_few_pictures_are_drawn(tmp_path: Path) -> None:
    messages = list(Site("s", seconds=4.0).messages())
    draw(tmp_path / "a.rrd", messages, picture_hz=2.0)
    stamps = [nanoseconds(m.open(PoseEstimate).timestamp) for m in messages if m.channel == POSE]
    plotted = rows(tmp_path / "a.rrd", "/belief/r1", "Scalars:scalars")
    assert [moment for moment, _ in plotted] == stamps
    pictures = rows(tmp_path / "a.rrd", "/world/robots/r1/tracks", "LineStrips3D:strips")
    assert 7 <= len(pictures) <= 9


@given(
    st.lists(st.floats(allow_nan=True, allow_infinity=True), max_size=20),
    st.floats(allow_nan=True, allow_infinity=True),
)
def test_shares_of_belief_are_a_sound_part_of_one(values: list[float], unlisted: float) -> None:
    share = probabilities(np.array(values, dtype=np.float64), unlisted)
    assert share.shape == (len(values),)
    assert np.all((share >= 0) & (share <= 1))
    assert share.sum() <= 1 + 1e-9


def test_shares_of_belief_have_the_odds_of_the_likelihoods() -> None:
    share = probabilities(np.log([0.2, 0.6]), math.log(0.2))
    assert share == pytest.approx([0.2, 0.6])


@given(st.integers(1, 10**15), st.floats(0.1, 100.0))
def test_what_follows_from_one_scan_is_drawn_together_or_not_at_all(start: int, rate: float) -> None:
    pace = Pace(rate)
    for step in range(20):
        moment = start + step * S // 30
        assert len({pace.due(kind, moment) for kind in ("pose", "tracks", "hypotheses")}) == 1


def test_the_ellipse_holds_95_percent() -> None:
    assert pytest.approx(math.sqrt(chi2.ppf(0.95, 2)), abs=1e-4) == MAHALANOBIS_95
    covariance = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, 0.0], [0.0, 0.0, 0.1]])
    offsets = ellipse([3.0, -1.0, 0.5], covariance) - [3.0, -1.0]
    distance = [offset @ np.linalg.inv(covariance[:2, :2]) @ offset for offset in offsets]
    assert distance == pytest.approx([chi2.ppf(0.95, 2)] * len(distance), rel=1e-4)


def test_an_arrow_points_along_the_heading() -> None:
    ((tail, tip, left, _, right),) = arrows([1.0, 2.0, math.pi / 2], 2.0, 0.1)
    assert tail == pytest.approx([1.0, 2.0, 0.1])
    assert tip == pytest.approx([1.0, 4.0, 0.1])
    assert left[0] == pytest.approx(2 * 1.0 - right[0])
    assert left[1] == right[1] < 4.0


def damaged(message: Envelope, dice: random.Random) -> Envelope | None:
    """The message with a few bytes of its encoding changed, where that still decodes."""
    raw = bytearray(message.message.SerializeToString())
    for _ in range(dice.randint(1, 4)):
        if raw:
            raw[dice.randrange(len(raw))] = dice.choice([0, 0x7F, 0x80, 0xFF, dice.randrange(256)])
    result = type(message.message)()
    try:
        result.ParseFromString(bytes(raw))
    except DecodeError:
        return None
    return Envelope(message.channel, message.address, result)


def test_whatever_decodes_can_be_drawn(tmp_path: Path) -> None:
    dice = random.Random(1)
    sound = [m for m in Site("s", seconds=1.0).messages() if m.channel != MAP]
    sound.append(
        Envelope(MAP, ADDRESS, grid_message(GridMap(np.zeros((4, 4), np.uint8), 0.1, np.zeros(3)), "map"))
    )
    broken = [damaged(dice.choice(sound), dice) for _ in range(3000)]
    empty = [Envelope(channel, sound[0].address, channel.message()) for channel in CHANNELS]
    draw(tmp_path / "a.rrd", [*empty, *(message for message in broken if message), *sound], draw_all=True)
    assert "/world/robots/r1/tracks" in entities(tmp_path / "a.rrd")


def test_a_file_that_cannot_be_written_is_a_problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun itself only logs that, and tries no further write."""
    monkeypatch.setattr(rerun_sink, "LOOK_S", 0.0)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    sink = RerunSink(RecorderOptions(rrd=tmp_path / "full.rrd"))
    behind = BackgroundSink(sink)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        deadline = time.monotonic() + 60.0
        messages = itertools.cycle(Site("s", seconds=1.0).messages())
        while not behind.problem and time.monotonic() < deadline:
            behind.write(next(messages))
        behind.close()  # raises nothing: the other sinks are to be closed, too
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert behind.problem.startswith(f"rrd: {tmp_path / 'full.rrd'}: a write failed")


def test_a_live_viewer_and_a_file_at_once(start_recorder: Callable[..., Any], tmp_path: Path) -> None:
    """A real process; it ends in time with both open, and the file is whole."""
    recorder = start_recorder("--rrd", str(tmp_path / "a.rrd"), "--viewer-port", "0", "--data-port", "0")
    published = list(Site(recorder.site, seconds=0.5).messages())
    for message in published:
        recorder.bus.publish(message)
    recorder.await_health(lambda health: health.counters.get("drawn", 0) >= len(published))
    assert recorder.viewer().startswith("http://127.0.0.1:")
    assert recorder.stop() == 0
    assert "/world/map" in entities(tmp_path / "a.rrd")


def hallway(components: int, embedding: Kind = "ring") -> RegionModel:
    """Model of a room of 6 x 4 m by analytic ranges; positions every metre."""
    index = np.array([[x, y] for x in range(1, 6) for y in range(1, 4)], dtype=np.int32)
    turns = np.arange(360) * math.radians(1.0)
    ranges = quantize(np.array([[to_wall(x, y, turn) for turn in turns] for x, y in index]))
    analysis = Analysis(Embedding.of(embedding), components=components)
    return RegionModel.of(analysis, "room", "map", 1.0, np.zeros(2), index, ranges, np.empty((0, 2)))


def to_wall(x: float, y: float, turn: float) -> float:
    cos, sin = math.cos(turn), math.sin(turn)
    along = (6 - x) / cos if cos > 1e-9 else -x / cos if cos < -1e-9 else math.inf
    across = (4 - y) / sin if sin > 1e-9 else -y / sin if sin < -1e-9 else math.inf
    return min(along, across)


@pytest.mark.parametrize("components", [2, 5])
@pytest.mark.parametrize("view_deg", [180, 100, 360])
def test_a_scan_at_a_place_lies_on_the_places_loop(components: int, view_deg: int) -> None:
    """By the definition, for the declared lidar and for others."""
    model = hallway(components)
    heading, place = math.radians(40.0), 7
    mount = np.array([0.2, -0.1, math.radians(30.0)])
    x, y = model.index[place].tolist()
    bearings = np.radians(np.arange(0, min(view_deg, 358) + 1) - view_deg / 2)
    scan = Scan(
        mount=to_message(mount),
        angle_min=bearings[0],
        angle_increment=math.radians(1.0),
        ranges=[to_wall(x, y, heading + bearing) for bearing in bearings],
    )
    analysis = analysis_of(model, scan)
    manifold = Manifold(model, analysis)
    space = model.derive(analysis)[0].space
    angle = np.array(scan.ranges)[::2] * (TURN / CIRCUMFERENCE)
    channels = np.stack([np.cos(angle), np.sin(angle)]) * CIRCUMFERENCE / TURN
    direct = [float(np.sum((channels - space.mean[:, None]) * vector)) for vector in space.vectors[:3]]
    direct += [0.0] * (3 - len(direct))
    base = compose([x, y, heading], inverse(mount))
    loop = manifold.loop(base, scan)
    assert np.array_equal(loop[0], loop[-1])
    # the lidar looks along one of the loop's headings; ranges travel in steps of a few millimetres
    assert np.linalg.norm(loop - np.array(direct), axis=1).min() < 0.02
    elsewhere = compose([*model.index[0].tolist(), heading], inverse(mount))
    assert np.linalg.norm(manifold.loop(elsewhere, scan) - np.array(direct), axis=1).min() > 0.5
    cloud = manifold.cloud()
    assert np.linalg.norm(cloud[:, None] - loop, axis=2).min() == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("embedding", ["ring", "range"])
def test_the_curves_are_the_scan_and_what_its_coefficients_stand_for(embedding: Kind) -> None:
    """Of a scan with one missing beam; with all components nothing is lost of it."""
    model = hallway(64, embedding)
    bearings = np.radians(np.arange(-20, 21))
    ranges = [to_wall(2, 1, 0.3 + bearing) for bearing in bearings]
    ranges[10] = math.nan
    scan = Scan(angle_min=bearings[0], angle_increment=math.radians(1.0), ranges=ranges)
    manifold = Manifold(model, analysis_of(model, scan))
    seen = manifold.seen(scan)
    assert seen == pytest.approx(ranges[::2], abs=1e-5, nan_ok=True)
    assert np.degrees(manifold.bearings(scan)) == pytest.approx(np.arange(-20, 21, 2), abs=1e-3)
    whole = np.array([to_wall(2, 1, 0.3 + bearing) for bearing in bearings[::2]])
    space = model.derive(analysis_of(model, scan))[0]
    offset = space.embedding(whole) - space.space.mean[:, None]
    alpha = [float(np.sum(offset * vector)) for vector in space.space.vectors]
    assert manifold.kept(alpha, seen) == pytest.approx(whole, abs=5e-3)
    vectors, shares = manifold.eigenscans(3)
    assert vectors.shape == (3, space.embedding.channels, 21)
    assert np.all(np.diff(shares) <= 0)
    assert 0.3 < shares.sum() < 1


def test_no_curve_leaves_its_panel() -> None:
    """Long beams through a doorway went through its top."""
    model, bearings = hallway(64), np.radians(np.arange(-20, 21))
    scan = Scan(angle_min=bearings[0], angle_increment=math.radians(1.0), ranges=[3.0] * 40 + [900.0])
    manifold, drawn = Manifold(model, analysis_of(model, scan)), list[Any]()
    canvas: Any = SimpleNamespace(style=lambda *_: None, draw=lambda _stamp, _path, what: drawn.append(what))
    curves.draw_scan(canvas, 0, "curves", manifold, scan, [0.0] * manifold.components)
    top = min(y for what in drawn for strip in what.strips.as_arrow_array().to_pylist() for _, y in strip)
    assert top == pytest.approx(-curves.SCAN_HEIGHT)


@pytest.mark.parametrize("robots", [2, 40])
def test_the_board_shows_who_needs_somebody_first(robots: int) -> None:
    """Few robots stay where they are; of many, those in need come first, in the colour of their state."""
    lines = [
        Line(f"r{n:02}", "LOST" if n == robots - 1 else "LOCALIZED", int(n == robots - 1), colour, "", "")
        for n in range(robots)
        for colour in [LOST if n == robots - 1 else LOCALIZED]
    ]
    order = shown(lines)
    assert {line.robot for line in order} == {line.robot for line in lines}
    first = order[-1] if robots <= MOST_BARS else order[0]
    assert first.robot == f"r{robots - 1:02}"
    image = draw_board(order)
    red = np.argwhere((image == LOST).all(axis=-1))
    green = np.argwhere((image == LOCALIZED).all(axis=-1))
    share = len(red) / (len(red) + len(green))
    assert share == pytest.approx(1 / robots, rel=0.3)
    assert (red[:, 0].min() < green[:, 0].max()) == (robots > MOST_BARS)


@pytest.mark.parametrize("robots", [7, 12, 50, 200])
def test_the_board_of_many_robots_fills_its_panel(robots: int) -> None:
    """Twelve robots took two thirds of it, two hundred a third of its width."""
    lines = [Line(f"r{n:03}", "LOCALIZED", 0, LOCALIZED, "", "") for n in range(robots)]
    height, width, _ = draw_board(lines).shape
    assert 0.7 < (width / height) / ASPECT < 1.4


def origins(panel: Any) -> set[str]:
    """Entities that the panels of a blueprint stand on."""
    if isinstance(panel, rrb.Container):
        return set().union(*(origins(part) for part in panel.contents))
    return {str(panel.origin)}


def test_no_panel_of_any_layout_stays_empty(tmp_path: Path) -> None:
    draw(tmp_path / "a.rrd", Site("s", seconds=3.0).messages(), draw_all=True)
    drawn = entities(tmp_path / "a.rrd")
    for layout in get_args(Layout):
        made = blueprint(layout, None, None, live=False, draw_all=True, has_truth=True)
        stood_on = origins(made.root_container)
        assert {"status", "world", "legend"} <= stood_on
        for origin in stood_on:
            assert any(entity.startswith(f"/{origin}") for entity in drawn), (layout, origin)


@pytest.mark.parametrize("layout", get_args(Layout))
def test_without_a_true_pose_no_layout_has_a_panel_of_errors(layout: Layout) -> None:
    errors = {"error/position", "error/heading"}
    real, simulated = (
        origins(blueprint(layout, None, None, live=False, has_truth=known).root_container)
        for known in (False, True)
    )
    assert not errors & real
    assert simulated - real == (errors if layout in ("operator", "developer") else set())


@pytest.mark.parametrize(("width", "length"), [(27.0, 5.0), (9.0, 1.0), (260.0, 50.0), (1.0, 0.5)])
def test_the_scale_bar_has_a_round_length_that_fits(width: float, length: float) -> None:
    assert scale_length(width) == length


def test_the_map_has_a_scale_bar_below_it(tmp_path: Path) -> None:
    draw(tmp_path / "a.rrd", Site("s", seconds=1.0).messages())
    ((_, labels),) = rows(tmp_path / "a.rrd", "/world/scale", "Points3D:labels")
    ((_, strips),) = rows(tmp_path / "a.rrd", "/world/scale", "LineStrips3D:strips")
    _, start, end, _ = np.array(strips[0])
    assert labels == [f"{end[0] - start[0]:g} m"]


@given(heading=st.floats(-4.0, 4.0), gap=st.floats(1.5, 20.0))
def test_a_label_is_never_on_its_arrows_side(heading: float, gap: float) -> None:
    pose = np.array([3.0, -2.0, heading])
    x, y = label_place(pose, gap) - pose[:2]
    assert x == 0.0
    assert abs(y) == pytest.approx(gap)
    assert y * np.sin(heading) <= 0.0


def test_a_range_beyond_the_ring_is_drawn_near_what_was_seen() -> None:
    model = hallway(64)
    analysis = replace(model.space.analysis, beams=1)
    manifold = Manifold(model, analysis)
    space = model.derive(analysis)[0]
    offset = space.embedding(np.array([10.5])) - space.space.mean[:, None]
    alpha = [float(np.sum(offset * vector)) for vector in space.space.vectors]
    assert manifold.kept(alpha, np.array([10.9], dtype=np.float32)) == pytest.approx([10.5], abs=1e-2)
    assert manifold.kept(alpha, np.array([np.nan], dtype=np.float32)) == pytest.approx([0.5], abs=1e-2)


def test_the_board_counts_robots_as_people_do() -> None:
    """Urgency first; then r2 before r10, also where zeros lead or the number is no number at all."""
    names = ["r10", "r2", "lift", "r002b", "r²"]
    many = [
        Line(name, "LOCALIZED", 0, LOCALIZED, "", "")
        for name in (*names, *(f"z{n}" for n in range(MOST_BARS)))
    ]
    urgent = Line("r9", "LOST", 1, LOST, "", "")
    order = [line.robot for line in shown([*many, urgent])]
    assert order[0] == "r9"
    assert order.index("lift") < order.index("r2") < order.index("r10")
    assert order.index("r002b") < order.index("r10")


@pytest.mark.parametrize(
    ("confidence", "step", "expected"),
    [
        (0.999, 1, 99),
        (0.999, 5, 95),
        (1.0, 5, 100),
        (0.29, 1, 29),
        (0.0, 5, 0),
        (-1.0, 1, 0),
        (math.nan, 1, 0),
    ],
)
def test_no_picture_states_more_than_the_tracker(confidence: float, step: int, expected: int) -> None:
    assert percent(confidence, step) == expected


def test_a_file_alone_is_waited_for_longer_than_a_live_viewer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eigenscan.recorder.rerun_sink.FLUSH_S", 1e-9)
    draw(tmp_path / "drive.rrd", Site("s", "r1", seconds=3.0).messages())
    assert {chunk.entity_path for chunk in RrdReader(str(tmp_path / "drive.rrd")).stream()} >= {"/world/map"}
