"""The error vector over the beams: what was seen minus what the map predicts, split by the mask."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.pace import Pace
from eigenscan.recorder.picture.palette import OBSTACLE, SCAN
from eigenscan.recorder.picture.scan_memory import ScanMemory
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Obstacles

EXPLAINED, UNEXPECTED = 1, 0


class BeamsPicture:
    """Draws E = S - S^ (paper, eq. 4) as two bar charts on one axis: what the map explains, and the rest."""

    def __init__(self, canvas: Canvas, pace: Pace, scans: ScanMemory) -> None:
        self._canvas, self._pace, self._scans = canvas, pace, scans

    def draw(self, heard: Envelope) -> None:
        """The error of each beam, m, over its angle, degrees."""
        message, where = heard.open(Obstacles), heard.address
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
