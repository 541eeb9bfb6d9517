"""Somebody on a robot's machine who publishes nonsense on its keys."""

from __future__ import annotations

import math
from random import Random

import zenoh
from eigenscan.schemas.channels import HYPOTHESES, ODOMETRY, POSE, SCAN, TRACKS, Channel
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis
from eigenscan.schemas.wire import encoding
from eigenscan.workbench.simtest.session import Bytes, Sample, Session
from eigenscan.workbench.simtest.site import SITE, Site
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

PERIOD_S, FLOOD_S = 0.3, 0.02
AHEAD_NS = 3_600_000_000_000


class Stranger:
    """Publishes until it leaves."""

    def __init__(self, site: Site, session: Session, seed: str, period_s: float = PERIOD_S) -> None:
        self._site, self._session, self._random = site, session, Random(seed)
        self._period_s = period_s

    def leave(self) -> None:
        """Closes its session."""
        self._site.network.close(self._session)

    def speak(self) -> None:
        """One message, and the next one later."""
        if self._session.is_open:
            self._site.network.publish(self._session, self._sample(), block=False)
            self._site.agenda.after(self._period_s, self.speak)

    def _sample(self) -> Sample:
        random, robot = self._random, self._session.machine
        if robot == SITE:
            robot = "r1"
        address = {"site": SITE, "robot": robot, "lidar": "front", "projector": "stranger"}
        channel: Channel = random.choice((SCAN, HYPOTHESES, ODOMETRY, TRACKS, POSE))
        key, reported = channel.key(address), encoding(channel)
        kind = random.randrange(6)
        if kind == 0:
            return Sample(key, Bytes(b"\xff" * random.randrange(1, 200)), reported)
        if kind == 1:
            return Sample(key, Bytes(b""), "text/plain")
        if kind == 2:
            return Sample(f"{SITE}/{random.choice(('robot', 'health', 'x'))}/{random.random()}", Bytes(b"x"))
        if kind == 3:
            return Sample(key, kind=zenoh.SampleKind.DELETE)
        if kind == 4:
            return Sample(
                HYPOTHESES.key(address), Bytes(self._list().SerializeToString()), encoding(HYPOTHESES)
            )
        return Sample(ODOMETRY.key(address), Bytes(self._odometry().SerializeToString()), encoding(ODOMETRY))

    def _list(self) -> Hypotheses:
        bad = self._random.choice((math.nan, math.inf, -math.inf, 1e300))
        return Hypotheses(
            timestamp=stamp(self._site.machines[self._session.machine].clock.time_ns()),
            frame_id="map",
            status=Hypotheses.STATUS_OK,
            hypotheses=[Hypothesis(pose=Pose2(x=bad), log_likelihood=bad)],
        )

    def _odometry(self) -> Odometry:
        now = self._site.machines[self._session.machine].clock.time_ns()
        bad = self._random.choice((math.nan, math.inf, 1e300))
        ahead = self._random.choice((0, AHEAD_NS))
        return Odometry(timestamp=stamp(now + ahead), pose=Pose(position=Vector3(x=bad)))
