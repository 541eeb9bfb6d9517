"""ROS bags of any container: LaserScan and Odometry; without Odometry, the base's motion in tf.

**Mounts** are the first transforms to each lidar's frame. **Stamps** are the headers', unless they are zero
or the topics' clocks disagree: then the time of recording counts for the topic that is off. A stray stamp is
put where its topic's pace has it (see `pace`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.ros_bridge.inbound import (
    Stamping,
    frame_name,
    header_stamp,
    on_plane,
    raw_scan,
    stated_covariance,
)
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.logs.bag import Bag, BagMessage
from eigenscan.workbench.logs.log import RECORDER_LAG_NS, LogOptions, in_order, odometry, place
from eigenscan.workbench.logs.pace import Pace, Stamped
from eigenscan.workbench.logs.ros_survey import MOVES, Lidar, Plan, survey_bag
from numpy.typing import NDArray


class RosLog:
    """A ROS bag; see the module for how mounts, odometry and stamps are found."""

    def __init__(self, path: Path, options: LogOptions, bag: Bag) -> None:
        self.path, self.format = path, bag.format
        self.counters: Counter[str] = Counter()
        self.logged: dict[int, int] = {}
        self.damage = ""
        base = options.base_frame and frame_name(options.base_frame)  # as tf has it, without a slash
        self._options, self._bag = replace(options, base_frame=base), bag
        self._finished = False

    @property
    def progress(self) -> float:
        """0..1 while iterating."""
        return 1.0 if self._finished else self._bag.progress

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError if there is no scan."""
        self.counters.clear()
        self.logged.clear()
        self._finished = False
        self._stamping = Stamping()
        plan = survey_bag(self._bag, self._options, self.counters)
        self._pace = Pace(plan.stamped)
        self._bag.counters.clear()
        messages = self._bag.messages([*plan.lidars, *plan.odometry])
        yield from in_order(self._convert(messages, plan), RECORDER_LAG_NS, self.counters, self.logged)
        self.counters.update(self._bag.counters)
        self._finished = True

    def _convert(self, messages: Iterator[BagMessage], plan: Plan) -> Iterator[Envelope]:
        for message in messages:
            body = message.message
            if hasattr(body, "transforms"):
                yield from self._odometry_of_transforms(message, plan)
                continue
            time = self._time(message.topic, body.header, message.time)
            if time is None:
                continue
            if message.topic in plan.lidars:
                lidar = plan.lidars[message.topic]
                if frame_name(body.header.frame_id) == lidar.frame:
                    after = self._stamping.after(body, time, message.time)
                    yield self._scan(body, lidar, time, after)
                else:  # another lidar's, which is mounted elsewhere
                    self.counters["scans_of_another_frame"] += 1
            else:
                pose = body.pose.pose
                yield from self._odometry(pose.position, pose.orientation, time, body.pose.covariance)

    def _time(self, topic: str, header: Any, recorded: int) -> int | None:
        """Stamp of a message, ns; None if it has none."""
        time = recorded
        if topic in self._pace:
            time = header_stamp(header)
            if self._pace.is_stray(topic, Stamped(recorded, time)):
                self.counters["stray_stamps"] += 1
                time = self._pace.due(topic, recorded)
        if time > 0:
            return time
        self.counters["no_stamp"] += 1
        return None

    def _scan(self, body: Any, lidar: Lidar, time: int, after: float) -> Envelope:
        message = raw_scan(body, time, lidar.mount, lidar.upside_down, after)
        place(self._options, lidar.name, message)
        address = {"site": self._options.site, "robot": self._options.robot, "lidar": lidar.name}
        return Envelope(SCAN_RAW, address, message)

    def _odometry(
        self, position: Any, orientation: Any, time: int, covariance: NDArray[np.float64] | None = None
    ) -> Iterator[Envelope]:
        pose = on_plane(position, orientation)
        if pose is None:
            self.counters["odometry_not_finite"] += 1
            return
        stated = [] if covariance is None else stated_covariance(covariance)
        yield odometry(self._options, time, pose, pose_covariance=stated)

    def _odometry_of_transforms(self, message: BagMessage, plan: Plan) -> Iterator[Envelope]:
        for item in message.message.transforms:
            frames = (frame_name(item.header.frame_id), frame_name(item.child_frame_id))
            if frames == (plan.moves_in, plan.base):
                time = self._time(MOVES, item.header, message.time)
                if time is not None:
                    yield from self._odometry(item.transform.translation, item.transform.rotation, time)
