"""The room of the paper's figure 9, by cast rays through the projector's and the tracker's cores.

A robot drives from the lower left of a square room to the upper right. Four poses look the same, except for
an optional niche in one wall.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap
from eigenscan.geometry.pose import compose, from_message, to_pose3
from eigenscan.geometry.pose import to_message as pose_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, SCAN_RAW, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.methods import of_service
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.schemas.tracking_pb2 import Tracks
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

Array = NDArray[np.float64]

ROOM_M = 8.0
CELL_M = 0.05
WALL_M = 0.5
"""Around the room on the map; the walls themselves are one cell thick."""
NICHE = (5.0, 6.5, 0.4)
"""m along the upper wall from, to, and its depth."""
OBSERVATIONS = 26
STEP_M = 0.25
TURN_RAD = 0.08
"""A step's greatest turn: the robot weaves, for on the room's diagonal a scan is its own mirror image."""
START = (1.5, 1.3, 0.6)
"""The robot's first pose, m, m, rad; the room's lower left corner is the map's origin."""
NOISE_M = 0.01
"""Standard deviation of a range: a time-of-flight scanner's."""
BEAMS, STEP_DEG, RANGE_MAX_M = 361, 0.5, 50.0
"""The paper's sensor."""
ROBOT = {"site": "figure", "robot": "r"}


@dataclass(frozen=True)
class Moment:
    """State after an observation: its number from 1, true pose (3,), the scan's list, the tracks."""

    number: int
    truth: Array
    hypotheses: Hypotheses
    tracks: Tracks

    @property
    def probabilities(self) -> list[float]:
        """Probabilities of the tracks at the true pose and at its three images, in this order."""
        return [
            sum(t.probability for t in self.tracks.tracks if is_near(from_message(t.pose), place))
            for place in quarter_turns(self.truth)
        ]

    @property
    def listed(self) -> list[bool]:
        """Whether the list has the true pose, and each of its three images."""
        poses = [from_message(h.pose) for h in self.hypotheses.hypotheses]
        return [any(is_near(pose, place) for pose in poses) for place in quarter_turns(self.truth)]


def square_room(niche: bool) -> GridMap:
    """The map of the room, with a niche in its upper wall or without one."""
    size = round((ROOM_M + 2 * WALL_M) / CELL_M)
    wall = round(WALL_M / CELL_M)
    free = np.zeros((size, size), dtype=bool)
    free[wall:-wall, wall:-wall] = True
    if niche:
        begin, end, depth = (round(value / CELL_M) for value in NICHE)
        free[size - wall : size - wall + depth, wall + begin : wall + end] = True
    cells = np.where(binary_dilation(free, np.ones((3, 3), dtype=bool)), OCCUPIED, UNKNOWN).astype(np.uint8)
    cells[free] = FREE
    return GridMap(cells, CELL_M, np.array([-WALL_M, -WALL_M, 0.0]))


def quarter_turns(pose: Array) -> Array:
    """The pose (3,) and its three images in the square room, (4, 3)."""
    centre = np.array([ROOM_M / 2, ROOM_M / 2, 0.0])
    turns = np.array([[0.0, 0.0, k * np.pi / 2] for k in range(4)])
    return compose(centre, compose(turns, pose - centre))


def is_near(pose: Array, place: Array) -> bool:
    """Whether a pose is within half a metre and 15 degrees, the resolution of a grid of half a metre."""
    turn = (pose[2] - place[2] + np.pi) % (2.0 * np.pi) - np.pi
    return bool(np.hypot(*(pose - place)[:2]) <= 0.5 and abs(turn) <= np.deg2rad(15.0))


def drive(
    niche: bool,
    method: str = "paper",
    seed: int = 9,
    start: tuple[float, float, float] = START,
    changes: Mapping[str, Mapping[str, object]] = MappingProxyType({}),
) -> Iterator[Moment]:
    """One observation a second, by the settings of a method; odometry is exact, ranges have noise.

    `changes` by service: settings that are different.
    """

    def chosen(service: str) -> dict[str, object]:
        return {**of_service(method, service), **changes.get(service, {})}

    grid, rng = square_room(niche), np.random.default_rng(seed)
    mapbuilder = MapbuilderSettings.model_validate(chosen("mapbuilder"))
    models = MapbuilderCore(mapbuilder, build_site(grid, mapbuilder.plan)).start()
    projector = ProjectorCore(ProjectorSettings.model_validate(chosen("projector")))
    tracker = TrackerCore(TrackerSettings.model_validate(chosen("tracker")))
    for model in models:
        if model.channel in projector.inputs:
            list(projector.handle(model))
    loop = Loopback([ScanIngestCore(ScanIngestSettings()), projector, tracker])
    loop.start()
    caster = RayCaster.of(grid)
    bearings = np.deg2rad(STEP_DEG) * (np.arange(BEAMS) - BEAMS // 2)
    truth, driven = np.array(start), np.zeros(3)
    for number in range(1, OBSERVATIONS + 1):
        at = stamp(number * 1_000_000_000)
        ranges = caster.cast(truth, bearings, RANGE_MAX_M)[0] + rng.normal(0.0, NOISE_M, BEAMS)
        scan = RawScan(
            timestamp=at,
            mount=pose_message(np.zeros(3)),
            angle_min=float(bearings[0]),
            angle_increment=float(np.deg2rad(STEP_DEG)),
            range_max=RANGE_MAX_M,
            ranges=ranges.tolist(),
        )
        published = [
            *loop.receive(
                Envelope(ODOMETRY, ROBOT, Odometry(timestamp=at, frame_id="odom", pose=to_pose3(driven)))
            ),
            *loop.receive(Envelope(SCAN_RAW, {**ROBOT, "lidar": "front"}, scan)),
        ]
        (listed,) = (each.open(Hypotheses) for each in published if each.channel is HYPOTHESES)
        (tracks,) = (each.open(Tracks) for each in published if each.channel is TRACKS)
        yield Moment(number, truth, listed, tracks)
        step = np.array([STEP_M, 0.0, TURN_RAD * np.cos(2.0 * np.pi * number / OBSERVATIONS)])
        truth, driven = compose(truth, step), compose(driven, step)
