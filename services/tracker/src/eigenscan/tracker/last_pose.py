"""The last pose that was claimed, on disk: a restarted tracker begins there, if that is not long ago.

It goes out as a relocation, which the tracker hears as it would anybody's: so it stands in the recording,
and a replay gives the same answers.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from eigenscan.schemas.channels import POSE, RELOCATION
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.geometry_pb2 import Covariance3
from eigenscan.schemas.group import holds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.options import TrackerOptions
from google.protobuf.message import DecodeError

KEEP_EVERY_NS = 1_000_000_000


class RememberingTracker(TrackerCore):
    """A tracker that keeps each robot's last claim in a folder, a file a robot, and begins there."""

    def __init__(self, settings: TrackerOptions, folder: Path) -> None:
        super().__init__(settings)
        self.says = (*TrackerCore.says, RELOCATION)
        self._told, self._folder = settings, folder
        self._kept_at: dict[str, int] = {}
        folder.mkdir(parents=True, exist_ok=True)

    def start(self) -> Iterator[Envelope]:
        """Where the robots were, as far as it is known and not too old."""
        for path in sorted(self._folder.glob(f"{self._told.site}.*.pose")):
            robot = path.name.removeprefix(f"{self._told.site}.").removesuffix(".pose")
            try:
                last = Relocation.FromString(path.read_bytes())
            except DecodeError:
                continue  # the machine went down while it was written
            age = time.time() - nanoseconds(last.timestamp) * 1e-9
            if holds(self._told.robot, robot) and 0.0 <= age <= self._told.last_pose_age:
                self._grow(last.covariance, age)
                yield Envelope(RELOCATION, {"site": self._told.site, "robot": robot}, last)

    def handle(self, heard: Envelope) -> Iterable[Envelope]:
        """What the tracker says; a claim among it is kept, once a second."""
        said = list(super().handle(heard))
        for envelope in said:
            if envelope.channel is POSE:
                self._keep(envelope.address["robot"], envelope.open(PoseEstimate))
        return said

    def _keep(self, robot: str, pose: PoseEstimate) -> None:
        stamp = nanoseconds(pose.timestamp)
        if pose.state != STATE_LOCALIZED or abs(stamp - self._kept_at.get(robot, 0)) < KEEP_EVERY_NS:
            return
        self._kept_at[robot] = stamp
        last = Relocation(
            timestamp=pose.timestamp, frame_id=pose.frame_id, pose=pose.pose, covariance=pose.covariance
        )
        path = self._folder / f"{self._told.site}.{robot}.pose"
        partial = path.with_suffix(".partial")
        try:
            partial.write_bytes(last.SerializeToString())
            partial.replace(path)
        except OSError:
            self._counts["pose_not_kept"] += 1

    def _grow(self, covariance: Covariance3, age: float) -> None:
        """W = T^2 v_max^2: what it may have driven meanwhile (paper, section 7)."""
        covariance.xx += (age * self._told.v_max) ** 2
        covariance.yy += (age * self._told.v_max) ** 2
        covariance.tt += (age * self._told.turn_max) ** 2
