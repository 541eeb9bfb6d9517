"""The last pose that was claimed, on disk: a restarted tracker begins there, if that is not long ago.

It goes out as a relocation, which the tracker receives as any other: so it stands in the recording,
and a replay gives the same answers. Disk and clock are of the shell; the core knows of neither.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from eigenscan.schemas.channels import POSE, RELOCATION, Channel
from eigenscan.schemas.envelope import Condition, Core, Envelope, nanoseconds
from eigenscan.schemas.group import holds
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Relocation
from eigenscan.tracker.options import TrackerOptions
from eigenscan.tracker.relocation import aged
from google.protobuf.message import DecodeError

KEEP_EVERY_NS = 1_000_000_000
"""By the claims' stamps, between two writes of a robot's file."""


class Remembering:
    """A tracker whose robots' last claims are kept in a folder, a file a robot, and that begins there."""

    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]

    def __init__(
        self, tracker: Core, options: TrackerOptions, folder: Path, clock: Callable[[], int] = time.time_ns
    ) -> None:
        self._tracker, self._options, self._folder, self._clock = tracker, options, folder, clock
        self.inputs, self.outputs = tracker.inputs, (*tracker.outputs, RELOCATION)
        self._kept_at: dict[str, int] = {}
        self._not_kept = 0
        folder.mkdir(parents=True, exist_ok=True)

    def start(self) -> Iterator[Envelope]:
        """Where the robots were, as far as it is known and not too old."""
        yield from self._tracker.start()
        for path in sorted(self._folder.glob(f"{self._options.site}.*.pose")):
            robot = path.name.removeprefix(f"{self._options.site}.").removesuffix(".pose")
            try:
                last = Relocation.FromString(path.read_bytes())
            except DecodeError:
                continue  # the machine went down while it was written
            age = (self._clock() - nanoseconds(last.timestamp)) * 1e-9
            if holds(self._options.robot, robot) and 0.0 <= age <= self._options.last_pose_age:
                address = {"site": self._options.site, "robot": robot}
                yield Envelope(RELOCATION, address, aged(last, age, self._options))

    def handle(self, received: Envelope) -> Iterator[Envelope]:
        """What the tracker publishes; a claim in it is kept, once a second."""
        for published in self._tracker.handle(received):
            if published.channel is POSE:
                self._keep(published.address["robot"], published.open(PoseEstimate))
            yield published

    def finish(self) -> Iterable[Envelope]:
        """What the tracker held back."""
        return self._tracker.finish()

    def condition(self) -> Condition:
        """The tracker's, and how often a claim could not be kept."""
        own = self._tracker.condition()
        if not self._not_kept:
            return own
        return replace(own, counters={**own.counters, "pose_not_kept": self._not_kept})

    def _keep(self, robot: str, pose: PoseEstimate) -> None:
        stamp = nanoseconds(pose.timestamp)
        if pose.state != STATE_LOCALIZED or abs(stamp - self._kept_at.get(robot, 0)) < KEEP_EVERY_NS:
            return
        self._kept_at[robot] = stamp
        last = Relocation(
            timestamp=pose.timestamp, frame_id=pose.frame_id, pose=pose.pose, covariance=pose.covariance
        )
        path = self._folder / f"{self._options.site}.{robot}.pose"
        partial = path.with_suffix(".partial")
        try:
            partial.write_bytes(last.SerializeToString())
            partial.replace(path)
        except OSError:
            self._not_kept += 1
