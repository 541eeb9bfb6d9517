"""Robots of a benchmark: what they publish, each in its own time, and what comes back."""

import heapq
import threading
import time
from dataclasses import dataclass, field

import numpy as np
import zenoh
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.bus import Bus
from eigenscan.schemas.channels import ODOMETRY, SCAN, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.simulation.stage import Stage

SITE = "scale"
RATE_HZ = 10.0
SPREAD_S = 20.0
"""The robots follow each other along one drive, within so many seconds."""
RIGHT_M = 0.5
ON_ROBOT = ("scan-ingest", "projector", "tracker")


@dataclass
class Received:
    """What came back within the window."""

    stage: Stage
    begin: float = np.inf
    end: float = np.inf
    sent: dict[tuple[str, int], tuple[float, int]] = field(default_factory=dict)
    """Robot and stamp -> when the scan was published, s, and its time in the drive, ns."""
    published: int = 0
    waits: list[float] = field(default_factory=list)
    wrong: int = 0
    claims: int = 0
    sizes: dict[str, list[int]] = field(default_factory=lambda: {"pose": [], "tracks": [], "health": []})

    def on_pose(self, sample: zenoh.Sample) -> None:
        now = time.monotonic()
        self._size("pose", sample)
        pose = PoseEstimate.FromString(sample.payload.to_bytes())
        published = self.sent.pop((str(sample.key_expr).split("/")[2], nanoseconds(pose.timestamp)), None)
        if published is None or not self.begin <= published[0] < self.end:
            return
        self.waits.append(now - published[0])
        if pose.state == STATE_LOCALIZED:
            x, y, _ = self.stage.pose_at(published[1])
            self.claims += 1
            self.wrong += bool(np.hypot(pose.pose.x - x, pose.pose.y - y) > RIGHT_M)

    def on_tracks(self, sample: zenoh.Sample) -> None:
        self._size("tracks", sample)

    def on_health(self, sample: zenoh.Sample) -> None:
        self._size("health", sample)

    def _size(self, name: str, sample: zenoh.Sample) -> None:
        self.sizes[name].append(len(sample.payload) + len(str(sample.key_expr)))

    def air(self, rate_hz: float) -> float:
        """Bytes a second that leave one robot."""
        typical = {name: float(np.mean(sizes or [0])) for name, sizes in self.sizes.items()}
        return rate_hz * typical["pose"] + typical["tracks"] + len(ON_ROBOT) * typical["health"]


def canonical(stage: Stage, rate_hz: float) -> list[tuple[int, Envelope]]:
    """Time in the drive, ns, and what the robot reports then: canonical scans and odometry, every so many."""
    ingest, published, every = ScanIngestCore(ScanIngestSettings()), [], round(RATE_HZ / rate_hz)
    count = {SCAN_RAW: 0, ODOMETRY: 0}
    for timed in stage.messages():
        channel = timed.envelope.channel
        if channel not in count:
            continue
        count[channel] += 1
        if (count[channel] - 1) % every:
            continue
        if channel is SCAN_RAW:
            published += [(timed.time, envelope) for envelope in ingest.handle(timed.envelope)]
        else:
            published.append((timed.time, timed.envelope))
    return published


def name_of(robot: int, groups: int) -> str:
    """Robots are dealt to the groups g0-*, g1-*, ... in turn."""
    return f"g{robot % groups}-{robot}"


def drive(
    bus: Bus,
    published: list[tuple[int, Envelope]],
    names: list[str],
    received: Received,
    stop: threading.Event,
) -> None:
    """Publishes the messages of these robots, each when its time has come, with stamps of now."""
    first, began, robots = published[0][0], time.monotonic(), len(names)
    rate_hz = sum(envelope.channel is SCAN for _, envelope in published) / (published[-1][0] - first) * 1e9
    wall = time.time_ns()
    times = np.array([at for at, _ in published])
    due: list[tuple[float, int, int, int]] = []
    for robot in range(robots):
        offset = int(robot * SPREAD_S / robots * 1e9)
        begin = int(np.searchsorted(times, first + offset))
        # robots are not in step: each has its own moment between two scans
        heapq.heappush(due, (robot / robots / rate_hz, robot, begin, int(times[begin])))
    while due and not stop.is_set():
        at, robot, index, origin = heapq.heappop(due)
        if (wait := began + at - time.monotonic()) > 0 and stop.wait(wait):
            return
        drive_time, envelope = published[index]
        now = wall + int(at * 1e9)
        envelope.message.timestamp.CopyFrom(stamp(now))  # type: ignore[attr-defined]
        name = names[robot]
        if envelope.channel is SCAN:
            moment = time.monotonic()
            received.sent[name, now] = (moment, drive_time)
            received.published += received.begin <= moment < received.end
        bus.publish(
            Envelope(envelope.channel, {"site": SITE, "robot": name, "lidar": "front"}, envelope.message)
        )
        if index + 1 < len(published):
            later = (published[index + 1][0] - drive_time) * 1e-9
            heapq.heappush(due, (at + later, robot, index + 1, origin))
