"""The eigenspace of the region that explains the scan best: its places, its hypotheses, and the scan."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
import rerun as rr
from eigenscan.eigenspace.model import ModelError
from eigenscan.recorder.picture.belief import HYPOTHESES_DRAWN, probabilities
from eigenscan.recorder.picture.canvas import REPEAT_NS, Canvas, Pace, ScanMemory, stamp_of
from eigenscan.recorder.picture.curves import draw_eigenscans, draw_scan
from eigenscan.recorder.picture.manifold import Manifold
from eigenscan.recorder.picture.palette import HYPOTHESIS, PLACE, SCAN, UNLIKELY, blend
from eigenscan.recorder.picture.shapes import are_places
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import RegionModel

MANIFOLDS_KEPT = 4


class EigenspacePicture:
    """Draws the first three coefficients (paper, eq. 2), m, in the space of the best hypothesis' region.

    And the same space as curves over the bearing.
    """

    def __init__(self, canvas: Canvas, pace: Pace, scans: ScanMemory) -> None:
        self._canvas, self._pace, self._scans = canvas, pace, scans
        self._models: dict[str, RegionModel] = {}
        self._manifolds: OrderedDict[str, Manifold] = OrderedDict()
        self._best: dict[str, str] = {}
        self._shown: dict[str, tuple[str, int]] = {}

    def keep_model(self, heard: Envelope) -> None:
        """Takes the newest model of a region."""
        region = heard.address["region"]
        self._models[region] = heard.open(RegionModel)
        self._manifolds.pop(region, None)
        self._shown = {robot: shown for robot, shown in self._shown.items() if shown[0] != region}

    def draw(self, heard: Envelope) -> None:
        """Scan and hypotheses; those of other regions live in other spaces and are left out."""
        message, robot = heard.open(Hypotheses), heard.address["robot"]
        stamp = stamp_of(message.timestamp)
        if stamp is None or not message.hypotheses or not self._pace.due(f"eigenspace/{robot}", stamp):
            return
        region = message.hypotheses[0].region
        settled = self._best.get(robot) == region
        self._best[robot] = region
        manifold = self._manifold(region) if settled else None
        scan = self._scans.newest(robot, heard.address["lidar"], stamp)
        if manifold is None or scan is None or not scan.angle_increment > 0:
            return
        shown, drawn_at = self._shown.get(robot, ("", 0))
        if shown != region or abs(stamp - drawn_at) >= REPEAT_NS:
            self._shown[robot] = region, stamp
            self._draw_places(stamp, robot, manifold)
            draw_eigenscans(self._canvas, stamp, f"curves/{robot}/eigenscans", manifold)
        draw_scan(self._canvas, stamp, f"curves/{robot}/scan", manifold, scan)
        listed = message.hypotheses[:HYPOTHESES_DRAWN]
        share = probabilities(np.array([h.log_likelihood for h in listed]), message.unlisted_log_likelihood)
        poses = np.array([[h.pose.x, h.pose.y, h.pose.theta] for h in listed])
        own = np.array([h.region == region for h in listed]) & are_places(poses)
        path = f"eigenspace/{robot}"
        self._canvas.style(f"{path}/hypotheses", _hypotheses_style)
        self._canvas.draw(
            stamp,
            f"{path}/hypotheses",
            rr.Points3D(manifold.poses(poses[own], scan), colors=blend(UNLIKELY, HYPOTHESIS, share[own])),
        )
        if own[0]:  # where a scan would lie if the robot turned on the spot at the best hypothesis
            self._canvas.style(f"{path}/loop", _loop_style)
            self._canvas.draw(stamp, f"{path}/loop", rr.LineStrips3D([manifold.loop(poses[0], scan)]))
        else:
            self._canvas.clear(stamp, f"{path}/loop")
        self._canvas.style(f"{path}/scan", _scan_style)
        self._canvas.draw(stamp, f"{path}/scan", rr.Points3D([manifold.scan(scan)]))

    def _draw_places(self, stamp: int, robot: str, manifold: Manifold) -> None:
        path = f"eigenspace/{robot}/places"
        self._canvas.style(path, _places_style)
        self._canvas.draw(stamp, path, rr.Points3D(manifold.cloud()))

    def _manifold(self, region: str) -> Manifold | None:
        """The region's space, of which a few are kept; None without a sound model."""
        if region in self._manifolds:
            self._manifolds.move_to_end(region)
        elif region in self._models:
            try:
                self._manifolds[region] = Manifold(self._models[region])
            except ModelError:
                del self._models[region]
                return None
            if len(self._manifolds) > MANIFOLDS_KEPT:
                self._manifolds.popitem(last=False)
        return self._manifolds.get(region)


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
