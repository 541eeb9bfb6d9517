"""A projector that compares a scan with every pose of the models, written against docs/contract.md alone.

Of Eigenscan it needs the generated messages and nothing else. Settings are in the environment, as for every
service: EIGENSCAN_ZENOH (JSON5; without it an embedded peer), EIGENSCAN_SITE, _ROBOT and _INSTANCE.
"""

from __future__ import annotations

import json
import os
import queue
import signal
import threading
import time
from collections import Counter, deque
from typing import TypeVar

import numpy as np
import zenoh
from comparison import Found, locate
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.model_pb2 import ModelSet, RegionModel
from eigenscan.schemas.scan_pb2 import Scan
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from google.protobuf.message import DecodeError, Message
from site_models import SiteModels

M = TypeVar("M", bound=Message)

UNDECLARED = {"", "zenoh/bytes", "application/octet-stream", "application/protobuf"}
LEAST_BEAMS = 24
MOST_BEAMS = 180  # of a full turn, as the contract counts `used_beams`
WAITING_SCANS = 64

site = os.environ.get("EIGENSCAN_SITE", "site")
robot = os.environ.get("EIGENSCAN_ROBOT", "robot")
instance = os.environ.get("EIGENSCAN_INSTANCE") or ("0" if robot == "*" else robot)


class Projector:
    """Receives scans and models, publishes hypotheses and health."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._models = SiteModels()
        self._counts = Counter(undecodable=0)
        self._scans: deque[zenoh.Sample] = deque(maxlen=WAITING_SCANS)
        self._latched: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self._newest: dict[str, zenoh.Timestamp] = {}
        self.news, self.over = threading.Event(), threading.Event()
        self._declared: list[zenoh.Subscriber[None] | zenoh.LivelinessToken] = [
            session.declare_subscriber(f"{site}/robot/{robot}/scan/*", self._on_scan)
        ]
        for channel, keys in (
            ("map", f"{site}/map"),
            ("model", f"{site}/model/*"),
            ("model_set", f"{site}/models"),
        ):
            self._follow(channel, keys)
        alive = f"{site}/alive/projector/{instance}/1"
        self._declared.append(session.liveliness().declare_token(alive))

    def _follow(self, channel: str, keys: str) -> None:
        """Receives a latched channel: what comes, and what each of its holders has kept."""

        def on_token(token: zenoh.Sample) -> None:
            if token.kind == zenoh.SampleKind.PUT:
                self._session.get(
                    keys,
                    lambda reply: self._on_latched(reply.ok) if reply.ok else None,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    priority=zenoh.Priority.DATA_LOW,
                    timeout=60.0,
                )

        self._declared.append(self._session.declare_subscriber(keys, self._on_latched))
        tokens = f"{site}/latched/{channel}/*"
        self._declared.append(self._session.liveliness().declare_subscriber(tokens, on_token, history=True))

    def _on_scan(self, sample: zenoh.Sample) -> None:
        self._scans.append(sample)
        self.news.set()

    def _on_latched(self, sample: zenoh.Sample) -> None:
        self._latched.put(sample)
        self.news.set()

    def work(self) -> None:
        """Takes all that has come, models first, then each scan; until it is over, however much waits."""
        self.news.clear()
        while not self._latched.empty():
            self._take_latched(self._latched.get())
        while self._scans and not self.over.is_set():
            sample = self._scans.popleft()
            scan = self._decode(sample, Scan)
            if scan:
                self._project(str(sample.key_expr), scan)
            while not self._latched.empty():
                self._take_latched(self._latched.get())

    def _take_latched(self, sample: zenoh.Sample) -> None:
        key, stamp = str(sample.key_expr), sample.timestamp
        kinds = {f"{site}/map": Grid, f"{site}/models": ModelSet}
        message = self._decode(sample, kinds.get(key, RegionModel))
        held = self._newest.get(key)
        if message is None or (held and stamp and stamp <= held):
            return
        if stamp:
            self._newest[key] = stamp
        self._models.put(message)

    def _decode(self, sample: zenoh.Sample, kind: type[M]) -> M | None:
        if sample.kind != zenoh.SampleKind.PUT:
            return None
        declared = str(sample.encoding)
        if declared in UNDECLARED | {encoding(kind)}:
            try:
                return kind.FromString(sample.payload.to_bytes())
            except DecodeError:
                pass
        self._counts["undecodable"] += 1
        return None

    def _project(self, key: str, scan: Scan) -> None:
        ranges = np.array(scan.ranges, dtype=np.float64)
        bearings = scan.angle_min + np.arange(len(ranges), dtype=np.float64) * scan.angle_increment
        mount = np.array([scan.mount.x, scan.mount.y, scan.mount.theta])
        if self._models.whole is None:
            self._counts["scan_without_model"] += 1
            return
        if not (np.isfinite(mount).all() and np.isfinite(bearings).all() and scan.angle_increment > 0):
            self._counts["scan_malformed"] += 1
            return
        announced, regions, building = self._models.whole
        returned = int(np.isfinite(ranges).sum())
        published = Hypotheses(
            timestamp=scan.timestamp,
            frame_id=announced.frame_id,
            model_version=announced.version,
            searched_area_m2=announced.free_area_m2,
            used_beams=min(int(returned * scan.angle_increment * MOST_BEAMS / (2.0 * np.pi)), MOST_BEAMS),
            status=Hypotheses.STATUS_UNUSABLE_SCAN,
        )
        with np.errstate(invalid="ignore"):
            is_usable = (ranges > 0.0).sum() == (~np.isnan(ranges)).sum() and returned >= LEAST_BEAMS
        if is_usable:
            found = locate(building, bearings, ranges)
            published.status = Hypotheses.STATUS_OK
            published.hypotheses.extend(listed(found, mount, regions))
            published.unlisted_log_likelihood = min(0.0, float(found.log_likelihoods[-1]))
        lidar = key.rpartition("/")[2]
        name = key.split("/")[2]
        self._publish(
            f"{site}/robot/{name}/hypotheses/{lidar}/{instance}",
            published,
            zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._counts["said_hypotheses"] += 1

    def report_health(self) -> None:
        """One Health message."""
        ready = self._models.whole is not None
        health = Health(
            service="projector",
            instance=instance,
            status=Health.STATUS_OK if ready else Health.STATUS_WAITING,
            detail="" if ready else "no model",
            counters={**self._counts, "refused_model": self._models.refused},
            package_version="0.1.0",
            settings=json.dumps({"site": site, "robot": robot, "instance": instance}),
        )
        health.timestamp.FromNanoseconds(time.time_ns())
        self._publish(f"{site}/health/projector/{instance}", health, zenoh.Priority.BACKGROUND, express=False)

    def _publish(self, key: str, message: Message, priority: zenoh.Priority, express: bool) -> None:
        payload = message.SerializeToString()
        self._session.put(
            key, payload, encoding=zenoh.Encoding(encoding(type(message))), priority=priority, express=express
        )


def encoding(kind: type[Message]) -> str:
    """As the contract has it."""
    return f"application/protobuf;{kind.DESCRIPTOR.full_name}/1"


def listed(found: Found, mount: np.ndarray, regions: list[str]) -> list[Hypothesis]:
    """Poses of the sensor as hypotheses of the base, which is where the mount (3,) gives them."""
    theta = found.poses[:, 2] - mount[2]
    c, s = np.cos(theta), np.sin(theta)
    x = found.poses[:, 0] - c * mount[0] + s * mount[1]
    y = found.poses[:, 1] - s * mount[0] - c * mount[1]
    J = np.tile(np.eye(3), (len(theta), 1, 1))
    J[:, 0, 2], J[:, 1, 2] = found.poses[:, 1] - y, x - found.poses[:, 0]
    C = J @ found.covariances @ J.transpose(0, 2, 1)
    headings = (theta + np.pi) % (2.0 * np.pi) - np.pi
    return [
        Hypothesis(
            pose=Pose2(x=x[i], y=y[i], theta=headings[i]),
            covariance=Covariance3(
                **{"xx": C[i, 0, 0], "xy": C[i, 0, 1], "xt": C[i, 0, 2]},
                **{"yy": C[i, 1, 1], "yt": C[i, 1, 2], "tt": C[i, 2, 2]},
            ),
            log_likelihood=found.log_likelihoods[i],
            region=regions[found.regions[i]],
            explained=found.explained[i],
        )
        for i in range(len(theta))
    ]


def main() -> None:
    """Runs until SIGTERM or SIGINT."""
    path = os.environ.get("EIGENSCAN_ZENOH")
    session = zenoh.open(zenoh.Config.from_file(path) if path else zenoh.Config())
    projector = Projector(session)

    def stop(*_: object) -> None:
        projector.over.set()
        projector.news.set()

    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGINT, stop)

    def publish() -> None:
        while True:
            projector.report_health()
            if projector.over.wait(1.0):
                return

    publisher = threading.Thread(target=publish)
    publisher.start()
    while not projector.over.is_set():
        if projector.news.wait(0.2):
            projector.work()
    publisher.join()
    session.close()


if __name__ == "__main__":
    main()
