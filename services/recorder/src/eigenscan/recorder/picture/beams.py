"""The error vector over the beams: what was seen minus what the map predicts, split by the mask."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.pace import Pace
from eigenscan.recorder.picture.palette import OBSTACLE, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Obstacles
from eigenscan.schemas.scan_pb2 import Scan

EXPLAINED, UNEXPECTED = 1, 0


class BeamsPicture:
    """Draws E = S - S^ (paper, eq. 4) as two bar charts on one axis: what the map explains, and the rest."""

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace
        self._angles: dict[tuple[str, str], tuple[float, float]] = {}

    def keep_angles(self, heard: Envelope) -> None:
        """Learns where the beams of a lidar look."""
        scan = heard.open(Scan)
        self._angles[heard.address["robot"], heard.address["lidar"]] = (
            scan.angle_min,
            scan.angle_increment,
        )

    def draw(self, heard: Envelope) -> None:
        """The error of each beam, m, over its angle, degrees."""
        message, where = heard.open(Obstacles), heard.address
        path = f"beams/{where['robot']}/{where['lidar']}"
        stamp = stamp_of(message.timestamp)
        number = min(len(message.error), len(message.mask))
        if stamp is None or not number or not self._pace.due(f"{path}/{where['projector']}", stamp):
            return
        error = np.nan_to_num(np.array(message.error[:number]), nan=0.0, posinf=0.0, neginf=0.0)
        mask = np.frombuffer(message.mask[:number], dtype=np.uint8)
        first, step = self._angles.get((where["robot"], where["lidar"]), (0.0, np.deg2rad(1.0)))
        degrees = np.rad2deg(first + step * np.arange(number))
        for name, value, colour in (
            ("explained", EXPLAINED, SCAN),
            ("unexpected", UNEXPECTED, OBSTACLE),
        ):
            self._canvas.draw(
                stamp,
                f"{path}/{name}",
                rr.BarChart(np.where(mask == value, error, 0.0), color=colour, abscissa=degrees),
            )
