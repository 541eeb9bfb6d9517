"""Draws hypotheses, tracks, and the scan's unexplained parts."""

from __future__ import annotations

import numpy as np
import rerun as rr
from eigenscan.geometry.pose import Array
from eigenscan.recorder.picture.canvas import Canvas, Pace, stamp_of
from eigenscan.recorder.picture.palette import HYPOTHESIS, OBSTACLE, TRACK, UNLIKELY, blend
from eigenscan.recorder.picture.shapes import are_places, arrows, is_place, lift
from eigenscan.schemas.channels import IN_PLAY
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, Hypotheses, Obstacles, SearchRequest
from eigenscan.schemas.tracking_pb2 import Tracks

HYPOTHESES_DRAWN = 12
"""The most likely of a list: the rest, a scan's worth of grey arrows, would hide the map."""
TRACKS_DRAWN = 50


def probabilities(log_likelihoods: Array, unlisted: float) -> Array:
    """Each hypothesis' share of the belief after this scan alone, (n,); the rest is for an unlisted place."""
    weights = np.concatenate([log_likelihoods, [unlisted]])
    weights = np.where(np.isfinite(weights), weights, -np.inf)
    highest = weights.max(initial=-np.inf)
    if not np.isfinite(highest):
        return np.zeros(len(log_likelihoods))
    with np.errstate(over="ignore"):  # so far below the highest is no share at all
        shares = np.exp(weights - highest)
    share: Array = shares[:-1] / shares.sum()
    return share


class BeliefPicture:
    """Draws hypotheses, tracks and obstacles of all robots."""

    def __init__(self, canvas: Canvas, pace: Pace) -> None:
        self._canvas, self._pace = canvas, pace

    def draw_hypotheses(self, received: Envelope) -> None:
        """Arrows, the longer and the more orange the more probable by this scan alone."""
        message, where = received.open(Hypotheses), received.address
        path = f"world/robots/{where['robot']}/hypotheses/{where['lidar']}/{where['projector']}"
        stamp = stamp_of(message.timestamp)
        if stamp is None or not self._pace.due(path, stamp):
            return
        listed = message.hypotheses[:HYPOTHESES_DRAWN]
        rows = [[h.pose.x, h.pose.y, h.pose.theta] for h in listed]
        poses = self._canvas.local(np.reshape(rows, (-1, 3)))
        share = probabilities(np.array([h.log_likelihood for h in listed]), message.unlisted_log_likelihood)
        usable = are_places(poses) & (share >= IN_PLAY * share.max(initial=0.0))
        poses, share = poses[usable], share[usable]
        self._canvas.style(path, _hypotheses_style)
        self._canvas.draw(
            stamp,
            path,
            rr.LineStrips3D(
                arrows(poses, 0.5 + 0.9 * share, 0.04),
                colors=blend(UNLIKELY, HYPOTHESIS, share),
            ),
        )

    def draw_search(self, received: Envelope) -> None:
        """The pose around which the next scan is to be fitted; none where the whole map is searched."""
        message, where = received.open(SearchRequest), received.address
        path = f"world/robots/{where['robot']}/search/{where['lidar']}"
        stamp = stamp_of(message.timestamp)
        if stamp is None or not self._pace.due(path, stamp):
            return
        poses = self._canvas.local([[message.pose.x, message.pose.y, message.pose.theta]])
        poses = poses[are_places(poses) & (message.search == SEARCH_LOCAL)]
        self._canvas.style(path, _search_style)
        self._canvas.draw(stamp, path, rr.LineStrips3D(arrows(poses, np.full(len(poses), 0.7), 0.05)))

    def draw_tracks(self, received: Envelope) -> None:
        """The trajectory of each track that is in play, the fainter the less probable."""
        message = received.open(Tracks)
        path = f"world/robots/{received.address['robot']}/tracks"
        stamp = stamp_of(message.timestamp)
        if stamp is None or not self._pace.due(path, stamp):
            return
        ways, shares = [], []
        for track in message.tracks[:TRACKS_DRAWN]:
            if track.probability < IN_PLAY:
                continue
            way = self._canvas.local([[p.x, p.y] for p in (*track.history, track.pose)])
            if is_place(way):
                ways.append(lift(way, 0.03))
                shares.append(track.probability)
        colours = blend(UNLIKELY, TRACK, np.array(shares))
        ends = np.array([way[-1] for way in ways]).reshape(-1, 3)
        self._canvas.style(path, _tracks_style)
        self._canvas.draw(
            stamp, path, rr.LineStrips3D(ways, colors=colours), rr.Points3D(ends, colors=colours)
        )

    def draw_obstacles(self, received: Envelope) -> None:
        """The points that the map does not explain, in red."""
        message, where = received.open(Obstacles), received.address
        path = f"world/robots/{where['robot']}/obstacles/{where['lidar']}"
        stamp = stamp_of(message.timestamp)
        if stamp is None or not self._pace.due(f"{path}/{where['projector']}", stamp):
            return
        number = min(len(message.map_x), len(message.map_y))
        points = self._canvas.local(np.column_stack([message.map_x[:number], message.map_y[:number]]))
        points = points[are_places(points)]
        self._canvas.style(path, _obstacles_style)
        self._canvas.draw(stamp, path, rr.Points3D(lift(points, 0.1)))


def _hypotheses_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(2.0)),)


def _search_style() -> tuple[rr.LineStrips3D]:
    return (rr.LineStrips3D.from_fields(colors=[TRACK], radii=rr.Radius.ui_points(1.0)),)


def _tracks_style() -> tuple[rr.LineStrips3D, rr.Points3D]:
    return (
        rr.LineStrips3D.from_fields(radii=rr.Radius.ui_points(1.5)),
        rr.Points3D.from_fields(radii=rr.Radius.ui_points(4.0)),
    )


def _obstacles_style() -> tuple[rr.Points3D]:
    return (rr.Points3D.from_fields(colors=[OBSTACLE], radii=rr.Radius.ui_points(3.5)),)
