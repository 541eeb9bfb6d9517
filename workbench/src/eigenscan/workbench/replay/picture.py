"""Draws both sides of a difference into one Rerun file: recorded and replayed messages on one map."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from eigenscan.geometry.pose import from_message
from eigenscan.recorder.picture.blueprint import UNKNOWN_FLOOR, eye
from eigenscan.recorder.picture.canvas import TIMELINE, Canvas
from eigenscan.recorder.picture.floor import Floor
from eigenscan.recorder.picture.shapes import Array32, are_places, arrows, is_place, lift, scan_points
from eigenscan.schemas.channels import HYPOTHESES, MAP, POSE, SCAN, TRACKS, Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Tracks
from eigenscan.workbench.replay.comparison import Finding
from eigenscan.workbench.replay.playing import Event, Side

AROUND_NS = 10_000_000_000
"""Time drawn before and after the first difference, ns."""
COLOURS = {Side.RECORDED: (0, 90, 200), Side.REPLAYED: (230, 110, 0)}
WIDTHS = {Side.RECORDED: 5.0, Side.REPLAYED: 2.0}
"""Widths of lines, in points: if both sides are equal, one is visible inside the other."""
NAMES = {Side.RECORDED: "recorded blue", Side.REPLAYED: "replayed orange"}
POSE_M, HYPOTHESIS_M = 1.4, 0.7


def draw(
    target: Path, events: Iterable[Event], latched: Iterable[Envelope], first: Finding, report: str
) -> None:
    """Draws both sides within AROUND_NS of the difference `first`. Raises OSError for the file."""
    target.open("wb").close()  # Rerun itself only logs that it cannot write
    stream = rr.RecordingStream("eigenscan replay")
    stream.save(str(target))
    picture = _Picture(stream)
    for envelope in latched:
        if envelope.channel is MAP:
            picture.floor.draw_map(envelope)
    picture.canvas.fix("report", rr.TextDocument(_difference_first(report)))
    stream.send_blueprint(_blueprint(picture.floor))
    for event in events:
        if event.envelope.channel.qos.latched:
            continue
        away = event.envelope.stamp - first.stamp
        if away > 2 * AROUND_NS and event.envelope.key == first.key:  # others may have another clock
            break
        if abs(away) <= AROUND_NS and event.side in COLOURS:
            picture.draw(event.side, event.envelope)
    stream.disconnect()


class _Picture:
    """Draws one message after the other."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self.canvas = Canvas(stream)
        self.floor = Floor(self.canvas)
        self._poses: dict[tuple[str, int], tuple[Side, PoseEstimate]] = {}
        self._drawn_by: dict[Channel, Callable[[Side, Envelope], None]] = {
            SCAN: self._draw_scan,
            HYPOTHESES: self._draw_hypotheses,
            TRACKS: self._draw_tracks,
            POSE: self._draw_pose,
        }

    def draw(self, side: Side, published: Envelope) -> None:
        """Draws a message, if it has a picture."""
        drawn_by = self._drawn_by.get(published.channel)
        if drawn_by:
            drawn_by(side, published)

    def _draw_scan(self, side: Side, published: Envelope) -> None:
        points = lift(scan_points(published.open(Scan), np.zeros(3)), 0.0)
        place = f"scan/{side.value}/{published.address['robot']}/{published.address['lidar']}"
        radius = rr.Radius.ui_points(WIDTHS[side])
        self.canvas.draw(published.stamp, place, rr.Points3D(points, colors=[COLOURS[side]], radii=radius))

    def _draw_hypotheses(self, side: Side, published: Envelope) -> None:
        address = published.address
        listed = [from_message(one.pose) for one in published.open(Hypotheses).hypotheses]
        poses = self.canvas.local(np.array(listed).reshape(-1, 3))
        strips = list(arrows(poses[are_places(poses)], HYPOTHESIS_M, 0.05))
        self._draw_lines(side, published, f"hypotheses/{address['lidar']}/{address['projector']}", strips)

    def _draw_tracks(self, side: Side, published: Envelope) -> None:
        ways = [
            self.canvas.local([(p.x, p.y) for p in (*one.history, one.pose)])
            for one in published.open(Tracks).tracks
        ]
        self._draw_lines(side, published, "tracks", [lift(way, 0.03) for way in ways if is_place(way)])

    def _draw_pose(self, side: Side, published: Envelope) -> None:
        message, robot = published.open(PoseEstimate), published.address["robot"]
        pose = self.canvas.local(from_message(message.pose))
        strips = list(arrows(pose, POSE_M, 0.1)) if message.track_id and is_place(pose) else []
        self._draw_lines(side, published, "pose", strips)
        stamp = published.stamp
        path = f"confidence/{robot}/{side.value}"
        self.canvas.style(path, lambda: (rr.SeriesLines(colors=[COLOURS[side]], names=[side.value]),))
        self.canvas.draw(stamp, path, rr.Scalars(message.confidence))
        other = self._poses.pop((robot, stamp), None)
        if other is None or other[0] is side:
            self._poses[robot, stamp] = side, message
        elif message.track_id and other[1].track_id:
            apart = math.dist((message.pose.x, message.pose.y), (other[1].pose.x, other[1].pose.y))
            self.canvas.draw(stamp, f"apart/{robot}", rr.Scalars(apart))

    def _draw_lines(self, side: Side, published: Envelope, what: str, strips: list[Array32]) -> None:
        place = f"world/{published.address['robot']}/{side.value}/{what}"
        lines = rr.LineStrips3D(strips, colors=[COLOURS[side]], radii=rr.Radius.ui_points(WIDTHS[side]))
        self.canvas.draw(published.stamp, place, lines)


def _difference_first(report: str) -> str:
    """The report with its last part, the first difference, at the top: the panel is small."""
    around, mark, difference = report.partition("first difference: ")
    return f"{mark}{difference}\n\n{around}"


def _blueprint(floor: Floor) -> rrb.Blueprint:
    """The map from above, with the differences beside it."""
    evidence = rrb.Vertical(
        rrb.Tabs(
            rrb.TextDocumentView(origin="report", name="What differs"),
            rrb.Spatial3DView(origin="scan", name="Canonical scans", line_grid=False),
        ),
        rrb.TimeSeriesView(origin="apart", name="Poses apart, m"),
        rrb.TimeSeriesView(origin="confidence", name="Confidence"),
        row_shares=[4, 2, 2],
    )
    where = rrb.Spatial3DView(
        origin="world",
        name=f"Where ({', '.join(NAMES.values())})",
        background=UNKNOWN_FLOOR,
        line_grid=False,
        eye_controls=eye(floor.extent),
    )
    return rrb.Blueprint(
        rrb.Horizontal(where, evidence, column_shares=[7, 4]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )
