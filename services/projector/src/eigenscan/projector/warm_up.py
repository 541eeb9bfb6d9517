"""Compiles all that a scan needs before the first one comes.

Without it the first scan on a new machine waits for numba: half a minute on a small or busy one.
"""

from __future__ import annotations

import numpy as np
from eigenscan.eigenspace.analysis import Analysis
from eigenscan.eigenspace.model import RegionModel, model_set, quantize
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, to_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.first_look import first_look
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.second_search import most_alike
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.verification import predicted
from eigenscan.schemas.channels import MAP, MODEL, MODEL_SET, SCAN, SEARCH, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SearchRequest
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, Track, Tracks

_CAP_M, _BEAMS, _SPACING_M = 15.0, 180, 0.25
"""m, number and m: of the room's models, and the beams of its scans."""
_PLACE = (2.2, 1.7, 0.4)
"""Pose of the scans, map frame."""


def warm_up(settings: ProjectorSettings) -> int:
    """Gives scans of a small simulated room to a separate core; returns the number of its messages.

    Two are searched in the whole map, the third around a pose. Then two places fit, and a move is advised.
    """
    core = ProjectorCore(settings)
    address = {"site": "warm-up", "robot": "warm-up", "lidar": "warm-up", "region": "room"}
    grid = _room()
    model = _model(grid)
    announced = model_set([model], grid.version, "map", grid.free_area)
    first, second, third = (Envelope(SCAN, address, _scan(grid, time)) for time in (1, 2, 3))
    received = [
        Envelope(MAP, address, to_message(grid, "map")),
        Envelope(MODEL, address, model.to_message()),
        Envelope(MODEL_SET, address, announced),
        first,
        second,
        Envelope(SEARCH, address, _request(second.stamp)),
        third,
        Envelope(TRACKS, address, _tracks(third.stamp)),
    ]
    _look_at(model)  # only what is large needs it, or what no place is sure of
    return sum(len(list(core.handle(envelope))) for envelope in received)


def _look_at(model: RegionModel) -> None:
    lattice = Lattice.of((model,))
    seen = lattice.panoramas[0]
    first_look(lattice, seen, np.isfinite(seen))
    shown = np.ascontiguousarray(predicted(lattice.panoramas, _BEAMS, _CAP_M))
    most_alike(shown, shown, np.arange(len(shown)), seen, _CAP_M, len(shown))


def _room() -> GridMap:
    """4 m by 3 m, with a cupboard."""
    cells = np.full((32, 42), OCCUPIED, dtype=np.uint8)
    cells[1:-1, 1:-1] = FREE
    cells[1:8, 1:12] = OCCUPIED
    return GridMap(cells, 0.1, np.zeros(3))


def _model(grid: GridMap) -> RegionModel:
    # finer than what is searched, so that the positions between are looked at too
    index = np.array([(x, y) for x in range(6, 15) for y in range(4, 11)], dtype=np.int32)
    panoramas = RayCaster.of(grid).panoramas(index * _SPACING_M, _BEAMS, _CAP_M)
    ranges = quantize(panoramas)
    return RegionModel.of(Analysis(), "room", "map", _SPACING_M, np.zeros(2), index, ranges, np.empty((0, 2)))


def _request(time: int) -> SearchRequest:
    """Around the scan's place, at any likelihood."""
    x, y, theta = _PLACE
    return SearchRequest(
        timestamp=stamp(time),
        frame_id="map",
        search=SEARCH_LOCAL,
        pose=Pose2(x=x, y=y, theta=theta),
        covariance=Covariance3(xx=0.01, yy=0.01, tt=0.001),
        least_log_likelihood=-1e6,
    )


def _tracks(time: int) -> Tracks:
    """At the scans' place, and at another."""
    x, y, theta = _PLACE
    poses = Pose2(x=x, y=y, theta=theta), Pose2(x=x, y=y, theta=theta + 2.0)
    tracks = [Track(id=i + 1, pose=pose, probability=0.5) for i, pose in enumerate(poses)]
    return Tracks(timestamp=stamp(time), frame_id="map", tracks=tracks, state=STATE_AMBIGUOUS)


def _scan(grid: GridMap, time: int) -> Scan:
    """From a place between the positions, with a beam that came back empty and one that is missing."""
    bearings = np.arange(_BEAMS) * (np.pi / _BEAMS) - np.pi / 2
    ranges = RayCaster.of(grid).cast(np.array(_PLACE), bearings, _CAP_M)[0]
    ranges[:2] = np.inf, np.nan
    return Scan(
        timestamp=stamp(time * 100_000_000),
        frame_id="base_link",
        angle_min=-np.pi / 2,
        angle_increment=np.pi / _BEAMS,
        range_min=0.05,
        range_max=_CAP_M,
        ranges=ranges.tolist(),
        sequence=time,
    )
