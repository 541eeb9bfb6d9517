"""The eigenspace of a scan's region: its places, its candidates, and the scan.

All lie in the projector's own space. It published the points of the scan and the candidates.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
import rerun as rr
from eigenscan.eigenspace.analysis import Analysis
from eigenscan.eigenspace.model import ModelError, RegionModel
from eigenscan.recorder.picture.belief import HYPOTHESES_DRAWN, probabilities
from eigenscan.recorder.picture.canvas import REPEAT_NS, Canvas, Pace, ScanMemory, stamp_of
from eigenscan.recorder.picture.curves import draw_eigenscans, draw_scan
from eigenscan.recorder.picture.manifold import Manifold, analysis_of, three
from eigenscan.recorder.picture.palette import HYPOTHESIS, PLACE, SCAN, UNLIKELY, blend
from eigenscan.recorder.picture.shapes import are_places
from eigenscan.schemas import model_pb2
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan

MANIFOLDS_KEPT = 4


class EigenspacePicture:
    """Draws the first three coefficients (paper, eq. 2), m, in the space of the best hypothesis' region.

    And the same space as curves over the bearing.
    """

    def __init__(self, canvas: Canvas, pace: Pace, scans: ScanMemory) -> None:
        self._canvas, self._pace, self._scans = canvas, pace, scans
        self._models: dict[str, RegionModel | model_pb2.RegionModel] = {}
        self._manifolds: OrderedDict[tuple[str, Analysis], Manifold] = OrderedDict()
        self._best: dict[str, str] = {}
        self._shown: dict[str, tuple[str, int]] = {}

    def keep_model(self, received: Envelope) -> None:
        """Takes the newest model of a region."""
        region = received.address["region"]
        self._models[region] = received.open(model_pb2.RegionModel)
        for key in [key for key in self._manifolds if key[0] == region]:
            del self._manifolds[key]
        self._shown = {robot: shown for robot, shown in self._shown.items() if shown[0] != region}

    def draw(self, received: Envelope) -> None:
        """Scan and hypotheses; those of other regions live in other spaces and are left out."""
        message, robot = received.open(Hypotheses), received.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None or not message.hypotheses:
            return
        region = message.hypotheses[0].region
        # two scans in a row, not two pictures: these are seconds apart, and a robot at a door would have none
        settled = self._best.get(robot) == region
        self._best[robot] = region
        if not settled or not self._pace.due(f"eigenspace/{robot}", stamp):
            return
        scan = self._scans.newest(robot, received.address["lidar"], stamp)
        if scan is None or not scan.angle_increment > 0:
            return
        manifold = self._manifold(region, scan)
        alpha = next((p.coefficients for p in message.projections if p.region == region), ())
        if manifold is None or len(alpha) != manifold.components:
            return
        shown, drawn_at = self._shown.get(robot, ("", 0))
        if shown != region or abs(stamp - drawn_at) >= REPEAT_NS:
            self._shown[robot] = region, stamp
            self._draw_places(stamp, robot, manifold)
            draw_eigenscans(self._canvas, stamp, f"curves/{robot}/eigenscans", manifold, scan)
        draw_scan(self._canvas, stamp, f"curves/{robot}/scan", manifold, scan, alpha)
        listed = message.hypotheses[:HYPOTHESES_DRAWN]
        share = probabilities(np.array([h.log_likelihood for h in listed]), message.unlisted_log_likelihood)
        poses = np.array([[h.pose.x, h.pose.y, h.pose.theta] for h in listed])
        alike = [h.region == region and len(h.coefficients) == len(alpha) for h in listed]
        own = np.array(alike) & are_places(poses)
        path = f"eigenspace/{robot}"
        self._canvas.style(f"{path}/hypotheses", _hypotheses_style)
        self._canvas.draw(
            stamp,
            f"{path}/hypotheses",
            rr.Points3D(
                three(np.array([h.coefficients for h, is_own in zip(listed, own, strict=True) if is_own])),
                colors=blend(UNLIKELY, HYPOTHESIS, share[own]),
            ),
        )
        if own[0]:  # the scan's points if the robot turned on the spot at the best hypothesis
            self._canvas.style(f"{path}/loop", _loop_style)
            self._canvas.draw(stamp, f"{path}/loop", rr.LineStrips3D([manifold.loop(poses[0], scan)]))
        else:
            self._canvas.clear(stamp, f"{path}/loop")
        self._canvas.style(f"{path}/scan", _scan_style)
        self._canvas.draw(stamp, f"{path}/scan", rr.Points3D(three(np.array([alpha]))))

    def _draw_places(self, stamp: int, robot: str, manifold: Manifold) -> None:
        path = f"eigenspace/{robot}/places"
        self._canvas.style(path, _places_style)
        self._canvas.draw(stamp, path, rr.Points3D(manifold.cloud()))

    def _manifold(self, region: str, scan: Scan) -> Manifold | None:
        """The region's space for the scan's lidar, of which a few are kept; None without a sound model."""
        message = self._models.get(region)
        try:
            model = (
                RegionModel.from_message(message) if isinstance(message, model_pb2.RegionModel) else message
            )
        except ModelError:
            del self._models[region]
            return None
        if model is None:
            return None
        self._models[region] = model
        analysis = analysis_of(model, scan)
        key = region, analysis
        if key not in self._manifolds:
            self._manifolds[key] = Manifold(model, analysis)
            if len(self._manifolds) > MANIFOLDS_KEPT:
                self._manifolds.popitem(last=False)
        self._manifolds.move_to_end(key)
        return self._manifolds[key]


def _places_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(colors=[PLACE], radii=rr.Radius.ui_points(1.5)),)


def _loop_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(colors=[HYPOTHESIS], radii=rr.Radius.ui_points(1.25)),)


def _hypotheses_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(radii=rr.Radius.ui_points(6.0)),)


def _scan_style() -> tuple[rr.Points3D]:
    return (
        rr.Points3D.from_fields(
            colors=[SCAN], radii=rr.Radius.ui_points(8.0), labels=["scan"], show_labels=True
        ),
    )
