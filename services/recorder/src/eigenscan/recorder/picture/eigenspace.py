"""The eigenspace of the region that explains the scan best: its scan and its hypotheses as points."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.recorder.picture.belief import HYPOTHESES_DRAWN, probabilities
from eigenscan.recorder.picture.canvas import Canvas, stamp_of
from eigenscan.recorder.picture.pace import Pace
from eigenscan.recorder.picture.palette import HYPOTHESIS, SCAN, UNLIKELY, blend
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from numpy.typing import NDArray


class EigenspacePicture:
    """Draws the first three coefficients (paper, eq. 2), m, of the best hypothesis' region."""

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace

    def draw(self, heard: Envelope) -> None:
        """Scan and hypotheses; those of other regions live in other spaces and are left out."""
        message, robot = heard.open(Hypotheses), heard.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None or not message.hypotheses or not self._pace.due(f"eigenspace/{robot}", stamp):
            return
        listed = message.hypotheses[:HYPOTHESES_DRAWN]
        region = listed[0].region
        share = probabilities(np.array([h.log_likelihood for h in listed]), message.unlisted_log_likelihood)
        own = np.array([h.region == region and len(h.coefficients) > 0 for h in listed], dtype=bool)
        points = [_three(h.coefficients) for h, here in zip(listed, own, strict=True) if here]
        path = f"eigenspace/{robot}/hypotheses"
        self._canvas.style(path, _hypotheses_style)
        self._canvas.draw(
            stamp,
            path,
            rr.Points3D(np.array(points).reshape(-1, 3), colors=blend(UNLIKELY, HYPOTHESIS, share[own])),
        )
        projections = [p for p in message.projections if p.region == region and p.coefficients]
        if projections:
            path = f"eigenspace/{robot}/scan"
            self._canvas.style(path, _scan_style)
            label = f"{robot}'s scan in {region}"
            self._canvas.draw(stamp, path, rr.Points3D([_three(projections[0].coefficients)], labels=[label]))


def _three(coefficients: object) -> NDArray[np.float32]:
    """The first three, 0 for what is missing or no number."""
    point = np.zeros(3, dtype=np.float32)
    first = np.asarray(coefficients, dtype=np.float32)[:3]
    point[: len(first)] = np.nan_to_num(first, nan=0.0, posinf=0.0, neginf=0.0)
    return point


def _hypotheses_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(radii=rr.Radius.ui_points(5.0)),)


def _scan_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(colors=[SCAN], radii=rr.Radius.ui_points(9.0), show_labels=True),)
