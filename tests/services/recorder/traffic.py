"""A site's traffic made by hand: a robot is lost, then in doubt, then knows; the truth is beside it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from eigenscan.eigenspace.analysis import Analysis
from eigenscan.eigenspace.model import RegionModel as Model
from eigenscan.eigenspace.model import quantize
from eigenscan.geometry.gridmap import to_message as grid_message
from eigenscan.geometry.pose import compose, covariance_to_message, to_message, transform
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.advice_pb2 import Advice
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
    POSE,
    RELOCATION,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    SEARCH,
    SPACE,
    TRACKS,
    TRANSFORM,
    Channel,
)
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import (
    SEARCH_LOCAL,
    Hypotheses,
    Hypothesis,
    Obstacles,
    Projection,
    SearchRequest,
)
from eigenscan.schemas.model_pb2 import LidarKind, ModelSet, RegionModel, RegionSpace
from eigenscan.schemas.scan_pb2 import RawScan, Scan, ScanMotion
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
    Relocation,
    Track,
    Tracks,
)
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import Scenario, Stage
from eigenscan.workbench.simulation.world import office
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from google.protobuf.message import Message

COVARIANCE = np.diag([0.03**2, 0.06**2, np.deg2rad(1.0) ** 2])


class Site:
    """Messages of every channel, in the order in which a recorder would receive them."""

    def __init__(self, site: str, robot: str = "r1", seconds: float = 12.0, seed: int = 1) -> None:
        self.grid = office().render()
        self.address = {
            "site": site,
            "robot": robot,
            "lidar": "front",
            "projector": "0",
            "region": "hallway",
            "kind": "ring8-180",
            "service": "tracker",
            "instance": "0",
        }
        lidar = Lidar(rate=10.0)
        self._stage = Stage(
            self.grid,
            Scenario(seconds=seconds, seed=seed, people=3, site=site, robot=robot, lidar=lidar),
        )
        self._caster = RayCaster.of(self.grid)
        self._random = np.random.default_rng(seed)
        self._seconds = seconds
        self._history: list[np.ndarray] = []
        self._count = 0
        self._begin = 0

    def messages(self) -> Iterator[Envelope]:
        timeline = list(self._stage.messages())
        self._begin = first = timeline[0].time
        yield self._publish(MAP, grid_message(self.grid, "map"))
        yield self._publish(MODEL, self._model())
        yield self._publish(MODEL_SET, ModelSet(timestamp=stamp(first), version="abc", frame_id="map"))
        yield self._publish(
            TRANSFORM,
            FrameTransform(timestamp=stamp(first), parent_frame_id="map", child_frame_id="odom"),
        )
        for timed in timeline:
            yield timed.envelope
            if timed.envelope.channel == SCAN_RAW:
                yield from self._follow(timed.envelope.open(RawScan), timed.time)

    def _publish(self, channel: Channel, message: Message) -> Envelope:
        return Envelope(channel, self.address, message)

    def _model(self) -> RegionModel:
        """The hallway, a position each metre."""
        index = np.array([[x, y] for x in range(1, 19) for y in range(1)], dtype=np.int32)
        positions = index + np.array([0.0, 6.5])
        ranges = quantize(self._caster.panoramas(positions, 720, 30.0))
        return hallway_model(index, ranges).to_message()

    def _follow(self, raw: RawScan, time: int) -> Iterator[Envelope]:
        """What the services make of a scan."""
        at = nanoseconds(raw.timestamp)
        turned = Heading(timestamp=raw.timestamp, since=stamp(self._begin), heading=1e-9 * (at - self._begin))
        yield self._publish(HEADING, turned)
        yield self._publish(SCAN_MOTION, ScanMotion(timestamp=raw.timestamp, since=stamp(at - 100_000_000)))
        scan = Scan(
            timestamp=raw.timestamp,
            frame_id="base",
            mount=raw.mount,
            angle_min=raw.angle_min,
            angle_increment=raw.angle_increment,
            range_min=raw.range_min,
            range_max=raw.range_max,
            ranges=raw.ranges,
            sequence=self._count,
        )
        yield self._publish(SCAN, scan)
        true = self._stage.pose_at(time)
        progress = (time - self._begin) * 1e-9 / self._seconds
        yield self._publish(HYPOTHESES, self._hypotheses(at, true, progress))
        yield self._publish(OBSTACLES, self._obstacles(scan, true))
        believed = compose(true, [0.05, -0.03, 0.01])
        self._history.append(believed)
        state = STATE_LOST if progress < 0.2 else STATE_AMBIGUOUS if progress < 0.45 else STATE_LOCALIZED
        confidence = min(0.97, 0.1 + progress)
        yield self._publish(TRACKS, self._tracks(at, confidence))
        yield self._publish(
            POSE,
            PoseEstimate(
                timestamp=stamp(at),
                frame_id="map",
                child_frame_id="base",
                pose=to_message(believed),
                covariance=covariance_to_message(COVARIANCE),
                state=state,
                confidence=confidence if state != STATE_LOST else 0.0,
                none_probability=1 - confidence,
                track_id=0 if state == STATE_LOST else 1,
            ),
        )
        if state == STATE_AMBIGUOUS:
            advice = Advice(
                timestamp=stamp(at), kind=Advice.KIND_MOVE, heading=0.7, distance=2.0, track_ids=[1, 2]
            )
            yield self._publish(ADVICE, advice)
        local = SearchRequest(
            timestamp=stamp(at), frame_id="map", search=SEARCH_LOCAL, pose=to_message(believed)
        )
        yield self._publish(SEARCH, local)
        if self._count % 10 == 0:
            yield self._publish(RELOCATION, Relocation(timestamp=stamp(at), pose=to_message(true)))
            yield self._publish(
                HEALTH, Health(timestamp=stamp(at), service="tracker", status=Health.STATUS_OK)
            )
            yield self._publish(LIDAR_KIND, LidarKind(timestamp=stamp(at), beams=180, cap=8.0))
            yield self._publish(SPACE, RegionSpace(region="hallway", model_version="abc"))
        self._count += 1

    def _hypotheses(self, at: int, true: np.ndarray, progress: float) -> Hypotheses:
        number = 12
        spread = self._random.uniform([0.5, 0.5, -3.1], [25.0, 11.5, 3.1], (number, 3))
        spread[0] = compose(true, self._random.normal(0, [0.05, 0.05, 0.01]))
        likelihood = np.concatenate([[8.0 * progress], -0.3 * np.arange(1, number)])
        coefficients = self._random.normal([20, 0, 0, 0], 8, (number, 4))
        coefficients[0] = [20 + 5 * np.cos(true[2]), 5 * np.sin(true[2]), true[0] / 3, 0]
        return Hypotheses(
            timestamp=stamp(at),
            frame_id="map",
            status=Hypotheses.STATUS_OK,
            unlisted_log_likelihood=-1.0,
            hypotheses=[
                Hypothesis(
                    pose=to_message(pose),
                    covariance=covariance_to_message(COVARIANCE),
                    log_likelihood=value,
                    region="hallway",
                    coefficients=place,
                )
                for pose, value, place in zip(spread, likelihood, coefficients, strict=True)
            ],
            projections=[Projection(region="hallway", coefficients=coefficients[0] + 0.5, searched=True)],
        )

    def _obstacles(self, scan: Scan, true: np.ndarray) -> Obstacles:
        ranges = np.array(scan.ranges)
        bearings = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
        sensor = compose(true, [scan.mount.x, scan.mount.y, scan.mount.theta])
        predicted = self._caster.cast(sensor[None], bearings, 30.0)[0]
        seen = np.isfinite(ranges) & np.isfinite(predicted)
        error = np.where(seen, ranges - predicted, np.nan)
        masked = seen & (error < -0.3)
        ends = np.stack([np.cos(bearings), np.sin(bearings)], axis=-1)[masked] * ranges[masked, None]
        points = transform(sensor, ends)
        return Obstacles(
            timestamp=scan.timestamp,
            frame_id="map",
            pose=to_message(true),
            mask=np.where(seen, np.where(masked, 0, 1), 255).astype(np.uint8).tobytes(),
            error=error,
            map_x=points[:, 0],
            map_y=points[:, 1],
        )

    def _tracks(self, at: int, probability: float) -> Tracks:
        other = compose(self._history[-1], [6.0, 1.0, 1.0])
        return Tracks(
            timestamp=stamp(at),
            frame_id="map",
            tracks=[
                Track(
                    id=1,
                    pose=to_message(self._history[-1]),
                    probability=probability,
                    history=[to_message(pose) for pose in self._history[-60:]],
                ),
                Track(id=2, pose=to_message(other), probability=(1 - probability) / 2),
            ],
            none_probability=(1 - probability) / 2,
        )


def hallway_model(index: np.ndarray, ranges: np.ndarray) -> Model:
    return Model.of(
        Analysis(components=4),
        region="hallway",
        frame_id="map",
        spacing=1.0,
        origin=np.array([0.0, 6.5]),
        index=index,
        ranges=ranges,
        outline=np.array([[0.0, 5.5], [19.0, 5.5], [19.0, 7.5], [0.0, 7.5]]),
    )
