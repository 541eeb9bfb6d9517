"""Robots that come by a building: scans, and the poses that a tracker would claim, a little off."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from eigenscan.geometry.gridmap import GridMap
from eigenscan.geometry.pose import between, compose, covariance_to_message, inverse, to_message
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.schemas.channels import POSE, SCAN
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.simulation.lidar import Lidar
from eigenscan.workbench.simulation.stage import EPOCH_NS, Scenario, Stage
from eigenscan.workbench.simulation.world import CUPBOARD, office

VISIT_S = 1800.0
ERROR = np.array([0.02, 0.02, np.deg2rad(0.3)])
KNOWN = office().render()
_FURNITURE = tuple(piece.moved(0.0, -1.9) if piece == CUPBOARD else piece for piece in office().furniture)
MOVED = replace(office(), furniture=_FURNITURE).render()
TOUR = ((5.2, 6.5), (5.2, 8.2), (8.3, 10.4), (6.6, 10.2), (5.2, 8.2), (5.2, 6.5), (12.0, 6.5))
"""From the hallway once around the bureau, whose cupboard moves, and out again."""


@dataclass(frozen=True)
class Patrol:
    """A drive, and what is claimed of it: the true pose, with an error that stays for a second, and `off`."""

    seed: int
    seconds: float = 75.0
    people: int = 2
    standing: tuple[tuple[float, float], ...] = ()
    off: tuple[float, float, float] = (0.0, 0.0, 0.0)
    confidence: float = 0.98
    lidar: Lidar = field(default_factory=lambda: Lidar(beams=181, rate=2.5))
    goals: tuple[tuple[float, float], ...] = TOUR

    def messages(
        self, grid: GridMap, at_s: float, site: str = "site", robot: str = "r1"
    ) -> Iterator[Envelope]:
        """Scan and pose by turns, `at_s` after the beginning."""
        scenario = Scenario(
            seconds=self.seconds,
            seed=self.seed,
            people=self.people,
            standing=self.standing,
            lidar=self.lidar,
            start=(1.5, 6.5),
            goals=self.goals,
            site=site,
            robot=robot,
        )
        stage = Stage(grid, scenario)
        stage.epoch = EPOCH_NS + round(at_s * 1e9)
        ingest, rng = ScanIngestCore(ScanIngestSettings()), np.random.default_rng(self.seed)
        odometry, count, error = dict(zip(stage.times.tolist(), stage.odometry, strict=True)), 0, np.zeros(3)
        for timed in stage.messages():
            if timed.envelope.channel.name != "scan_raw":
                continue
            for published in ingest.handle(timed.envelope):
                if published.channel is SCAN:
                    yield published
            if count % round(self.lidar.rate) == 0:
                error = rng.normal(0.0, 1.0, 3) * ERROR
            count += 1
            base = stage.pose_at(timed.time) + error + self.off
            yield Envelope(
                POSE, {"site": site, "robot": robot}, self._claim(timed.time, base, odometry[timed.time])
            )

    def _claim(self, time: int, base: np.ndarray, odometry: np.ndarray) -> PoseEstimate:
        return PoseEstimate(
            timestamp=stamp(time),
            frame_id="map",
            pose=to_message(base),
            covariance=covariance_to_message(np.diag([0.03**2, 0.03**2, np.deg2rad(1.3) ** 2])),
            state=STATE_LOCALIZED,
            confidence=self.confidence,
            has_odometry=True,
            map_to_odom=to_message(compose(base, inverse(odometry))),
            track_id=1,
        )


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """m, between two poses."""
    return float(np.hypot(*between(one, other)[:2]))
