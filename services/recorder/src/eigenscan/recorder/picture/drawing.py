"""The picture: which message is drawn by whom."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.advice import AdvicePicture
from eigenscan.recorder.picture.belief import BeliefPicture
from eigenscan.recorder.picture.blueprint import blueprint
from eigenscan.recorder.picture.canvas import Canvas, Pace, ScanMemory
from eigenscan.recorder.picture.eigenspace import EigenspacePicture
from eigenscan.recorder.picture.floor import Floor
from eigenscan.recorder.picture.layout import Layout
from eigenscan.recorder.picture.models import ModelsPicture
from eigenscan.recorder.picture.motion import MotionPicture, RelocationPicture
from eigenscan.recorder.picture.plots import BeamsPicture, Plots
from eigenscan.recorder.picture.robot import RobotPicture
from eigenscan.recorder.picture.sensors import FramesPicture, RawScanPicture
from eigenscan.recorder.picture.status import Events, StatusBoard
from eigenscan.schemas.channels import (
    ADVICE,
    HEADING,
    HEALTH,
    HYPOTHESES,
    LIDAR_KIND,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    ODOMETRY,
    POSE,
    RELOCATION,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    SEARCH,
    SPACE,
    TRACKS,
    TRANSFORM,
    TRUTH,
    Channel,
)
from eigenscan.schemas.envelope import Envelope

LEGEND = """
The **bar on top** shows the state:
**LOCALIZED** (green): one pose is sure enough to act on;
**AMBIGUOUS** (amber): no pose is sure enough yet;
**LOST** (red): no pose is likely, so none is drawn;
**SILENT** (grey): no pose comes any more;
**WAITING** (grey): scans arrive, but no pose yet.

**On the map** (north up, metres):
- **arrow with a disc**, in the state's colour: the estimated pose; the outline holds it in 95 of 100 cases
- **thin black circle**: the protection level; with at most the configured risk the true position is outside
- **blue points**: the scan, drawn at that pose; it lies on the walls when the pose is right
- **red points**: unexpected; the map does not explain them
- **black arrow**: the true pose, where it is known
- **orange arrows**: the best hypotheses of the last scan; grey: improbable
- **purple lines**: tracks and their past, from 1 % on; grey: improbable
- **teal arrow with words**: the move that would distinguish the places that fit
- **blue arrow with an ellipse**: the last relocation
- **bar below the map**: its scale

**Panels**:
- **How sure**: the confidence that the pose is within 0.5 m and 10 degrees; the belief in no track at all.
- **Error**: distance from the true pose, m.
- **Beams**: observed minus predicted range of each beam, m; blue: explained, red: unexpected.
- **Eigenspace**: the scan (blue) and its hypotheses (orange; grey: improbable) by their first three
  coefficients in the best region's space. The pale cloud is that region, all places and headings; the orange
  loop is the best hypothesis' place, turned once round: the scan lies on it when the place is right.
- **Scan and eigen-scans**: the scan's ranges (blue) and what the region's eigenspace keeps of them (orange);
  below, the first eigen-scans (purple), of which it is mixed.
- **Speed, Turn rate**: of the robot, by odometry (orange) and by its scans alone (blue): they should agree.
- **Models**: which models and map are in use.
- **Raw scans, Frames**: with `draw_all` only: what the driver gives (red: beyond the sensor's limits), in the
  robot's own frame; the coordinate frames, each in its parent.
- **Events**: changes of state and of the services' health; kinds of lidar that eigenspaces were added for.

Hidden at first: the outlines of the regions that have an eigenspace (`world/regions`).
"""


CHARTS_LESS_OFTEN = 5
"""Charts are dear to draw and slow to read: by this factor less often than the map."""

Draw = Callable[[Envelope], None]


class Picture:
    """Draws the traffic of a site, any number of robots on one map."""

    def __init__(
        self,
        stream: rr.RecordingStream,
        rate_hz: float,
        layout: Layout,
        window_s: float | None,
        *,
        live: bool,
        draw_all: bool = False,
    ) -> None:
        """`rate_hz`: pictures per second and robot at most; `draw_all`: also raw scans and frames.

        The others: see `blueprint.blueprint`.
        """
        self._draw_all, self._has_truth = draw_all, False
        self._stream, self._layout, self._window_s, self._live = stream, layout, window_s, live
        canvas, scans = Canvas(stream), ScanMemory()
        pace, charts = Pace(rate_hz), Pace(rate_hz / CHARTS_LESS_OFTEN)
        self._floor, self._plots = Floor(canvas), Plots(canvas)
        robots = RobotPicture(canvas, pace, scans, lambda: self._floor.label_gap, brief=layout == "fleet")
        belief = BeliefPicture(canvas, pace)
        beams, space = BeamsPicture(canvas, charts, scans), EigenspacePicture(canvas, charts, scans)
        advice = AdvicePicture(canvas)
        board, events = StatusBoard(canvas), Events(canvas)
        self._motion = MotionPicture(canvas)
        self._drawn_by: dict[Channel, tuple[Draw, ...]] = {
            MAP: (self._draw_map,),
            MODEL: (self._floor.draw_region,),
            MODEL_SET: (ModelsPicture(canvas, self._floor).draw,),
            RELOCATION: (RelocationPicture(canvas, brief=layout == "fleet").draw,),
            POSE: (robots.draw_pose, advice.receive_pose, board.receive_pose, self._plots.receive_pose),
            ADVICE: (advice.draw,),
            TRUTH: (self._note_truth, robots.draw_truth, self._plots.receive_truth),
            LIDAR_KIND: (events.receive_kind,),
            SPACE: (events.receive_space,),
            HEALTH: (events.receive_health, board.receive_health),
        }
        if draw_all or layout != "fleet":  # many robots' guesses would hide the map
            self._drawn_by |= {
                MODEL: (self._floor.draw_region, space.keep_model),
                SCAN: (scans.keep, robots.receive_scan, board.receive_scan),
                HYPOTHESES: (belief.draw_hypotheses, space.draw),
                SEARCH: (belief.draw_search,),
                OBSTACLES: (belief.draw_obstacles, beams.draw),
                TRACKS: (belief.draw_tracks,),
                ODOMETRY: (self._motion.receive_odometry,),
                HEADING: (self._motion.receive_heading,),
                SCAN_MOTION: (self._motion.receive_scan_motion,),
            }
        if draw_all:
            self._drawn_by |= {
                SCAN_RAW: (RawScanPicture(canvas, pace).draw,),
                TRANSFORM: (FramesPicture(canvas, pace).draw,),
            }
        canvas.fix("legend", rr.TextDocument(LEGEND, media_type=rr.MediaType.MARKDOWN))
        self._show()

    @property
    def channels(self) -> frozenset[Channel]:
        """Those that are drawn."""
        return frozenset(self._drawn_by)

    def draw(self, received: Envelope) -> None:
        """Draws one message; channels without a picture are left out."""
        with np.errstate(all="ignore"):  # each drawer leaves out invalid numbers
            for draw in self._drawn_by.get(received.channel, ()):
                draw(received)

    def flush(self) -> None:
        """Draws waiting content."""
        self._plots.flush()
        self._motion.flush()

    def _draw_map(self, received: Envelope) -> None:
        before = self._floor.extent
        self._floor.draw_map(received)
        if before is None and self._floor.extent is not None:
            self._show()

    def _note_truth(self, _: Envelope) -> None:
        if not self._has_truth:
            self._has_truth = True
            self._show()

    def _show(self) -> None:
        self._stream.send_blueprint(
            blueprint(
                *(self._layout, self._floor.extent, self._window_s),
                live=self._live,
                draw_all=self._draw_all,
                has_truth=self._has_truth,
            )
        )
