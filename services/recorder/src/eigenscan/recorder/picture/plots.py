"""Plots over time: confidence, the probability of none of the tracks, and the error if the truth is known."""

from __future__ import annotations

from collections import defaultdict, deque

import numpy as np
import rerun as rr
from eigenscan.geometry.circle import difference
from eigenscan.geometry.pose import Array, from_message, from_pose3
from eigenscan.recorder.picture.canvas import Canvas, Pace, ScanMemory, stamp_of
from eigenscan.recorder.picture.palette import LOCALIZED, LOST, OBSTACLE, SCAN, TRUTH, Colour
from eigenscan.recorder.picture.shapes import is_place
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Obstacles
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

ROWS_A_BATCH = 16
BATCH_NS = 250_000_000
MOMENTS_KEPT = 256
TRUTH_GAP_NS = 500_000_000
"""Between two true poses further apart than this nothing is interpolated."""


class Series:
    """Rows of scalars on one entity, sent in batches: one call for many rows."""

    def __init__(self, canvas: Canvas, path: str, names: list[str], colours: list[Colour]) -> None:
        self._canvas, self._path = canvas, path
        self._stamps: list[int] = []
        self._rows: list[tuple[float, ...]] = []
        canvas.fix(path, rr.SeriesLines(names=names, colors=colours, widths=[2.0] * len(names)))

    def add(self, stamp: int, *values: float) -> None:
        """Adds a row; an invalid number leaves a gap."""
        self._stamps.append(stamp)
        self._rows.append(values)
        if len(self._rows) >= ROWS_A_BATCH or not 0 <= stamp - self._stamps[0] < BATCH_NS:
            self.flush()

    def flush(self) -> None:
        """Sends waiting rows."""
        if self._rows:
            self._canvas.plot(self._path, self._stamps, self._rows)
            self._stamps, self._rows = [], []


class Plots:
    """Draws the time plots of all robots."""

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._series: dict[str, Series] = {}
        self._truth: dict[str, deque[tuple[int, Array]]] = defaultdict(lambda: deque(maxlen=MOMENTS_KEPT))
        self._open: dict[str, deque[tuple[int, Array]]] = defaultdict(lambda: deque(maxlen=MOMENTS_KEPT))

    def receive_pose(self, received: Envelope) -> None:
        """Plots the belief; the error as soon as the truth of that moment is known."""
        message, robot = received.open(PoseEstimate), received.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None:
            return
        belief = self._of(
            f"belief/{robot}",
            [f"{robot}: confidence", f"{robot}: none of the tracks"],
            [LOCALIZED, LOST],
        )
        belief.add(stamp, message.confidence, message.none_probability)
        pose = from_message(message.pose)
        if message.track_id and is_place(pose):
            self._open[robot].append((stamp, pose))
            self._settle(robot)

    def receive_truth(self, received: Envelope) -> None:
        """Keeps the true pose, and plots the errors that waited for it."""
        message, robot = received.open(PoseInFrame), received.address["robot"]
        stamp, pose = stamp_of(message.timestamp), from_pose3(message.pose)
        if stamp is None or not is_place(pose):
            return
        known = self._truth[robot]
        if known and stamp <= known[-1][0]:
            known.clear()
        known.append((stamp, pose))
        self._settle(robot)

    def flush(self) -> None:
        """Sends waiting rows."""
        for series in self._series.values():
            series.flush()

    def _settle(self, robot: str) -> None:
        """Plots the error of each pose up to the newest true pose."""
        known, waiting = self._truth[robot], self._open[robot]
        while known and waiting and waiting[0][0] <= known[-1][0]:
            stamp, pose = waiting.popleft()
            true = true_pose(known, stamp)
            if true is not None:
                distance = float(np.hypot(*(pose - true)[:2]))
                turn = float(np.rad2deg(abs(difference(pose[2], true[2]))))
                self._of(f"error/position/{robot}", [f"{robot}: position error, m"], [OBSTACLE]).add(
                    stamp, distance
                )
                self._of(f"error/heading/{robot}", [f"{robot}: heading error, deg"], [TRUTH]).add(stamp, turn)

    def _of(self, path: str, names: list[str], colours: list[Colour]) -> Series:
        if path not in self._series:
            self._series[path] = Series(self._canvas, path, names, colours)
        return self._series[path]


def true_pose(known: deque[tuple[int, Array]], stamp: int) -> Array | None:
    """The true pose at `stamp`, between the two around it; None if they are far apart or missing."""
    after = next((index for index, (at, _) in enumerate(known) if at >= stamp), None)
    if after is None:
        return None
    later, end = known[after]
    if later == stamp:
        return end
    if after == 0 or later - known[after - 1][0] > TRUTH_GAP_NS:
        return None
    earlier, start = known[after - 1]
    share = (stamp - earlier) / (later - earlier)
    step = end - start
    step[2] = difference(end[2], start[2])
    return np.asarray(start + share * step)


EXPLAINED, UNEXPECTED = 1, 0


class BeamsPicture:
    """Draws E = S - S^ (paper, eq. 4) as two bar charts on one axis: what the map explains, and the rest."""

    def __init__(self, canvas: Canvas, pace: Pace, scans: ScanMemory) -> None:
        self._canvas, self._pace, self._scans = canvas, pace, scans

    def draw(self, received: Envelope) -> None:
        """The error of each beam, m, over its angle, degrees."""
        message, where = received.open(Obstacles), received.address
        path = f"beams/{where['robot']}/{where['lidar']}"
        stamp = stamp_of(message.timestamp)
        number = min(len(message.error), len(message.mask))
        if stamp is None or not number or not self._pace.due(f"{path}/{where['projector']}", stamp):
            return
        scan = self._scans.newest(where["robot"], where["lidar"], stamp)
        if scan is None:
            return
        error = np.nan_to_num(np.array(message.error[:number]), nan=0.0, posinf=0.0, neginf=0.0)
        mask = np.frombuffer(message.mask[:number], dtype=np.uint8)
        degrees = np.rad2deg(scan.angle_min + scan.angle_increment * np.arange(number))
        for name, value, colour in (
            ("explained", EXPLAINED, SCAN),
            ("unexpected", UNEXPECTED, OBSTACLE),
        ):
            self._canvas.draw(
                stamp,
                f"{path}/{name}",
                rr.BarChart(np.where(mask == value, error, 0.0), color=colour, abscissa=degrees),
            )
