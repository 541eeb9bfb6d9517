"""The core: converts raw scans to canonical scans, and counts rejected ones by reason."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.doubtful_ranges import NEAREST_M, not_in_metres, one_value
from eigenscan.geometry.message_floats import floats_of, put_floats
from eigenscan.geometry.normalize import (
    FARTHEST_MOUNT,
    FAULTS,
    Ranges,
    ScanError,
    Sweep,
    limit,
    limits,
    orient,
    own_beams,
    resample,
)
from eigenscan.ingest.deskew import Deskew, Timing
from eigenscan.ingest.robot_body import RobotBody
from eigenscan.ingest.settings import EVERY_LIDAR, ScanIngestSettings
from eigenscan.ingest.watch import FROZEN, Watch
from eigenscan.schemas.channels import SCAN, SCAN_MOTION, SCAN_RAW, Channel, ContractError
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.recently_used import RecentlyUsed
from eigenscan.schemas.scan_pb2 import RawScan, Scan, ScanMotion

RECENT = 50
GAP_NS = 1_000_000_000
"""Time between two scans, ns, beyond which the lidar paused, or its clock was set forward; stamps do not show
which."""
SILENT = 2 * RECENT
"""Scans that each of the others sends meanwhile, after which a lidar is off: health is of those that send."""
NAMED = 5
"""Number of late scans, or of one of these reasons, among a lidar's latest RECENT that shows a fault."""
SHOWN = {
    "one_value": f"covered: all beams have one value, in {NAMED} or more of the last {RECENT} scans",
    "not_in_metres": (
        f"has no range below {NEAREST_M:.0f} m: are its ranges millimetres? They must be metres"
    ),
}
"""The fault of a lidar whose scans, the newest too, are set aside for a reason."""
WHY = FAULTS | {
    "other_message": "its sender uses another version of the contract",
    "too_many_beams": "scans have more beams than the setting max_beams allows",
    "mount_not_finite": "the mount must be numbers",
    "duplicate_stamp": "each scan needs a new stamp: is it in whole seconds, or published twice?",
    "out_of_order": "stamps go backwards: do two drivers use one name, or two clocks?",
    "two_lidars": "mounts differ by turns: do two lidars use one name?",
}
"""What a reason means and what mends it, by its counter's name."""


@dataclass
class _Lidar:
    """State of one lidar of one robot."""

    newest: int | None = None  # ns, stamp of the last scan published
    followed: int | None = None  # ns, stamp of the last scan in order, also of one that was set aside
    late: int = 0  # scans in a row that lie before it
    latest_late: int = 0  # ns, stamp of the last of those
    published: int = 0
    watch: Watch = field(default_factory=Watch)
    deskew: Deskew = field(default_factory=Deskew)
    body: RobotBody = field(default_factory=RobotBody)
    recent: deque[str] = field(default_factory=lambda: deque(maxlen=RECENT))  # why set aside, or ""
    received: int = 0  # how many scans of all lidars were received when its last one was

    @property
    def fault(self) -> str:
        """Its fault, as words after its name, which stay the same while it lasts; empty if there is none."""
        recent = list(self.recent)
        if self.watch.repeats + 1 >= FROZEN:
            return f"frozen: {FROZEN} or more scans repeat earlier ones (or it is simulated without noise)"
        newest = recent[-1] if recent else ""
        if newest in SHOWN and recent.count(newest) >= NAMED:
            return SHOWN[newest]
        if self.watch.two_lidars:
            return "has two mounts by turns: do two lidars use this name?"
        turns = sum((a == "out_of_order") != (b == "out_of_order") for a, b in pairwise(recent))
        if turns >= 2 * NAMED:
            return (
                "has stamps of two times by turns: do two lidars or two robots use this name, or two clocks?"
            )
        reasons = Counter(reason for reason in recent if reason)
        if 2 * reasons.total() > len(recent):
            worst, _ = reasons.most_common(1)[0]
            return f"has most of its latest scans set aside ({worst}): {WHY[worst]}"
        return ""


class ScanIngestCore:
    """Normalizes the scans of any number of lidars; see the README for the rules."""

    inputs: tuple[Channel, ...] = (SCAN_RAW,)
    outputs: tuple[Channel, ...] = (SCAN, SCAN_MOTION)

    def __init__(self, settings: ScanIngestSettings) -> None:
        self._settings = settings
        self._step = None if settings.angle_step is None else math.radians(settings.angle_step)
        self._lidars: RecentlyUsed[tuple[str, str], _Lidar] = RecentlyUsed()
        self._counts: Counter[str] = Counter(heard=0, published=0, lidars=0)

    def start(self) -> Iterable[Envelope]:
        """Publishes nothing."""
        return ()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """The canonical scan of a raw one unless it was set aside; before it, now and then, the motion."""
        self._counts["heard"] += 1
        lidar = self._lidars.use((received.address["robot"], received.address["lidar"]), self._new_lidar)
        lidar.received = self._counts["heard"]
        try:
            raw = received.open(RawScan)
        except ContractError:
            return self._set_aside(lidar, "other_message")
        try:
            scan, ranges = self._normalize(lidar, received.address["lidar"], raw)
        except ScanError as unusable:
            return self._set_aside(lidar, unusable.reason)
        lidar.recent.append("")
        self._counts["published"] += 1
        motion = list(self._motion(lidar, received, scan, ranges))
        for each in motion:
            scan.motion.CopyFrom(each.open(ScanMotion))
        return (*motion, Envelope(SCAN, received.address, scan))

    def finish(self) -> Iterable[Envelope]:
        """Publishes nothing: no scan waits here."""
        return ()

    def condition(self) -> Condition:
        """DEGRADED if a lidar that sends is frozen, covered, doubled, or mostly set aside."""
        counters = dict(self._counts)
        if not len(self._lidars):
            return Condition(Health.STATUS_WAITING, "no scan received yet", counters)
        sending = [
            (f"lidar {robot}/{name}", lidar)
            for (robot, name), lidar in self._lidars.items()
            if self._counts["heard"] - lidar.received <= SILENT * len(self._lidars)
        ]
        if faults := [f"{name} {lidar.fault}" for name, lidar in sending if lidar.fault]:
            return Condition(Health.STATUS_DEGRADED, "; ".join(faults[:3]), counters)
        notes = [f"{name} {lidar.body.note}" for name, lidar in sending if lidar.body.note]
        return Condition(Health.STATUS_OK, "; ".join(notes[:3]), counters)

    def _set_aside(self, lidar: _Lidar, reason: str) -> Iterable[Envelope]:
        self._counts[f"set_aside_{reason}"] += 1
        lidar.recent.append(reason)
        return ()

    def _motion(self, lidar: _Lidar, received: Envelope, scan: Scan, ranges: Ranges) -> Iterator[Envelope]:
        mount = (scan.mount.x, scan.mount.y, scan.mount.theta)
        motion = lidar.watch.receive(
            nanoseconds(scan.timestamp), ranges, scan.angle_min, scan.angle_increment, mount
        )
        if motion is None:
            return
        since, moved = motion
        message = ScanMotion(
            timestamp=scan.timestamp, since=stamp(since), repeats=lidar.watch.repeats, watched=True
        )
        if moved is not None:
            message.explained, message.longest_step = moved.explained, lidar.watch.longest_step
        else:
            self._counts["identical_scans"] += 1
        if moved is not None and moved.fits:
            x, y, theta = moved.delta
            lidar.body.turn(theta)
            (xx, xy, xt), (_, yy, yt), (_, _, tt) = moved.covariance.tolist()
            message.motion.CopyFrom(Pose2(x=x, y=y, theta=theta))
            message.covariance.CopyFrom(Covariance3(xx=xx, xy=xy, xt=xt, yy=yy, yt=yt, tt=tt))
        yield Envelope(SCAN_MOTION, received.address, message)

    def _normalize(self, lidar: _Lidar, name: str, raw: RawScan) -> tuple[Scan, Ranges]:
        time = nanoseconds(raw.timestamp)
        self._check_order(lidar, time)
        mount, upside_down = self._mount(name, raw)
        if not math.isfinite(raw.angle_min):  # of no layout
            raise ScanError("angles_not_finite")
        lidar.watch.receive_layout((mount.x, mount.y, mount.theta), raw.angle_min)
        if lidar.watch.two_lidars:
            raise ScanError("two_lidars")
        range_min, range_max = self._limits(raw)
        sweep = orient(Sweep(self._ranges(raw), raw.angle_min, raw.angle_increment), upside_down)
        sweep = Sweep(limit(sweep.ranges, range_min, range_max), sweep.angle_min, sweep.angle_increment)
        sweep = lidar.body.without(sweep)
        if np.isnan(sweep.ranges).all():
            raise ScanError("no_valid_range")
        step, sweep = sweep.angle_increment, own_beams(sweep)
        # orient has reversed the beams of a lidar that turns clockwise
        increment = -raw.time_increment if (raw.angle_increment < 0.0) != upside_down else raw.time_increment
        own = Timing(increment * round(sweep.angle_increment / step), raw.stamped_after)
        straight = lidar.deskew.take(sweep, own, (mount.x, mount.y, mount.theta), time)
        if straight is not sweep:
            self._counts["deskewed"] += 1
            sweep = Sweep(
                limit(straight.ranges, range_min, range_max), sweep.angle_min, sweep.angle_increment
            )
        if self._step is not None:
            sweep = resample(sweep, self._step)
        if one_value(sweep.ranges, sweep.angle_increment):
            raise ScanError("one_value")
        scan = Scan(
            timestamp=raw.timestamp,
            frame_id=self._settings.base_frame,
            mount=mount,
            angle_min=sweep.angle_min,
            angle_increment=sweep.angle_increment,
            range_min=range_min,
            range_max=range_max,
            sequence=lidar.published,
            gathered=raw.gathered,
        )
        put_floats(scan, Scan.RANGES_FIELD_NUMBER, sweep.ranges)
        if lidar.newest is not None and time < lidar.newest:
            self._counts["clock_steps"] += 1
        lidar.newest, lidar.late, lidar.published = time, 0, lidar.published + 1
        return scan, sweep.ranges

    def _new_lidar(self) -> _Lidar:
        self._counts["lidars"] += 1
        return _Lidar()

    def _check_order(self, lidar: _Lidar, stamp: int) -> None:
        """Raises ScanError for a stamp that is not after the newest.

        A row of such scans with stamps that increase among themselves means that the clock was set
        back (or ran ahead once): then the new time holds.
        """
        if lidar.newest is None or stamp > lidar.newest:
            if lidar.followed is not None and stamp - lidar.followed > GAP_NS:
                self._counts["stamp_gaps"] += 1
            lidar.followed = stamp
            return
        if stamp == lidar.newest:
            raise ScanError("duplicate_stamp")
        lidar.late = lidar.late + 1 if lidar.late and stamp > lidar.latest_late else 1
        lidar.latest_late = stamp
        if lidar.late < self._settings.clock_step_scans:
            raise ScanError("out_of_order")
        lidar.followed = stamp

    def _mount(self, name: str, raw: RawScan) -> tuple[Pose2, bool]:
        override = self._settings.mounts.get(name) or self._settings.mounts.get(EVERY_LIDAR)
        if override is not None:
            pose = Pose2(x=override.x, y=override.y, theta=math.radians(override.yaw))
            return pose, override.upside_down
        if not all(map(math.isfinite, (raw.mount.x, raw.mount.y, raw.mount.theta))):
            raise ScanError("mount_not_finite")
        if max(abs(raw.mount.x), abs(raw.mount.y)) > FARTHEST_MOUNT:
            raise ScanError("mount_too_far")
        if not -math.pi <= raw.mount.theta < math.pi:
            theta = float(wrap(raw.mount.theta))
            return Pose2(x=raw.mount.x, y=raw.mount.y, theta=theta), raw.upside_down
        return raw.mount, raw.upside_down

    def _limits(self, raw: RawScan) -> tuple[float, float]:
        """Both limits, m; the settings win over the scan's. Raises ScanError."""
        settings = self._settings
        low = raw.range_min if settings.range_min is None else settings.range_min
        high = raw.range_max if settings.range_max is None else settings.range_max
        return limits(low, high)

    def _ranges(self, raw: RawScan) -> Ranges:
        count = len(raw.ranges)
        if count == 0:
            raise ScanError("no_beams")
        if count > self._settings.max_beams:
            raise ScanError("too_many_beams")
        ranges = floats_of(raw, "ranges")
        if not_in_metres(ranges):
            raise ScanError("not_in_metres")
        return ranges
