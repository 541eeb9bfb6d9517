"""ROS bags of any container: LaserScan and Odometry, mounts and, without Odometry, odometry from tf.

**Mounts** are what tf first says of each lidar's frame. **Stamps** are the headers', unless they are zero
or the clocks of the topics disagree: then the time of recording counts for the topic that is off.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.cli.importers.bag import LASER_SCAN, ODOMETRY_MESSAGE, TRANSFORMS, Bag, BagMessage
from eigenscan.cli.importers.log import (
    ODOMETRY_FRAME,
    RECORDER_LAG_NS,
    LogError,
    LogOptions,
    in_order,
    odometry,
    raw_scan,
)
from eigenscan.cli.importers.transforms import TransformTree, planar, rotation_matrix
from eigenscan.schemas.envelope import Envelope
from numpy.typing import NDArray

CLOCKS_APART_NS = 1_000_000_000
SAME_PLANE_M = 0.5
STRAY_STAMP_NS = 10_000_000_000
USUAL_BASES = ("base_footprint", "base_link", "base", "base_frame")
NO_ODOMETRY = re.compile(r"truth|gazebo|slam|amcl|map", re.IGNORECASE)


@dataclass(frozen=True)
class _Lidar:
    """One lidar of the log: where it sits, and the name it gets."""

    name: str
    mount: NDArray[np.float64]
    upside_down: bool


@dataclass
class _Survey:
    """What the first messages of a bag tell."""

    tree: TransformTree = field(default_factory=TransformTree)
    frames: dict[str, str] = field(default_factory=dict)  # by lidar topic
    spans: dict[str, int] = field(default_factory=dict)  # deg, field of view by lidar topic
    offsets: dict[str, int] = field(default_factory=dict)  # ns, header's stamp minus time of recording
    base: str | None = None  # what odometry says that it moves


class RosLog:
    """A ROS bag; see the module for how mounts, odometry and stamps are found."""

    def __init__(self, path: Path, options: LogOptions, bag: Bag) -> None:
        self.path, self.format = path, bag.format
        self.counters: Counter[str] = Counter()
        self._options, self._bag = options, bag
        self._finished = False

    @property
    def progress(self) -> float:
        """0..1 while iterating."""
        return 1.0 if self._finished else self._bag.progress

    def envelopes(self) -> Iterator[Envelope]:
        """SCAN_RAW and ODOMETRY by stamp. Raises LogError where there is no scan."""
        self.counters.clear()
        self._finished = False
        kinds = self._bag.topics()
        scans = [topic for topic, kind in kinds.items() if kind == LASER_SCAN]
        odometries = [topic for topic, kind in kinds.items() if kind == ODOMETRY_MESSAGE]
        transforms = [topic for topic, kind in kinds.items() if kind == TRANSFORMS]
        chosen = self._choose_odometry(odometries)
        wanted = self._choose_lidars(scans)
        survey = self._survey([*wanted, *transforms, *([chosen] if chosen else [])], wanted, chosen)
        base = self._options.base_frame or self._base(survey)
        lidars = self._lidars(survey, base)
        if not lidars:
            raise LogError(f"{self.path}: holds no horizontal laser scan ({LASER_SCAN}) on any topic")
        source = [chosen] if chosen else transforms
        self._bag.counters.clear()
        messages = self._bag.messages([*lidars, *source])
        trusted = self._trusted_stamps(survey)
        converted = self._convert(messages, lidars, base, survey.offsets, trusted)
        yield from in_order(converted, RECORDER_LAG_NS, self.counters)
        self.counters.update(self._bag.counters)
        self._finished = True

    def _choose_odometry(self, topics: list[str]) -> str | None:
        asked = self._options.odometry
        if asked is not None:
            if asked not in topics:
                raise LogError(f"{self.path}: no odometry topic {asked}: there are {_listed(topics)}")
            return asked
        raw = [topic for topic in topics if not NO_ODOMETRY.search(topic)]
        return min(raw, key=lambda topic: ("odom" not in topic, len(topic), topic), default=None)

    def _choose_lidars(self, topics: list[str]) -> list[str]:
        asked = self._options.lidars
        names = lidar_names(topics)
        chosen = [topic for topic in topics if not asked or {topic, names[topic]} & set(asked)]
        missing = set(asked) - set(topics) - set(names.values())
        if missing or not topics:
            what = f"no lidar topic {missing.pop()}" if missing else "holds no laser scan"
            raise LogError(f"{self.path}: {what}: topics of {LASER_SCAN}: {_listed(topics)}")
        return chosen

    def _survey(self, topics: list[str], lidars: list[str], odometry_topic: str | None) -> _Survey:
        """Reads until each lidar has been heard and its frame is connected to the base, or to the end."""
        survey = _Survey()
        for message in self._bag.messages(topics):
            if hasattr(message.message, "transforms"):
                _hear_transforms(survey.tree, message.message)
            elif message.topic not in survey.offsets:
                survey.offsets[message.topic] = _stamp(message.message.header) - message.time
                frame = _frame(message.message.header.frame_id)
                if message.topic in lidars:
                    survey.frames[message.topic] = frame
                    survey.spans[message.topic] = _span(message.message)
                else:
                    survey.base = _frame(message.message.child_frame_id) or None
            if len(survey.frames) == len(lidars) and (
                odometry_topic is None or odometry_topic in survey.offsets
            ):
                base = self._options.base_frame or self._base(survey)
                frames = survey.frames.values()
                if base and all(survey.tree.between(base, frame) is not None for frame in frames):
                    break
        return survey

    def _base(self, survey: _Survey) -> str | None:
        moved = survey.tree.children(ODOMETRY_FRAME)
        named = [frame for frame in (survey.base, *USUAL_BASES) if frame]
        candidates = [frame for frame in named if survey.tree.knows(frame) or frame == survey.base]
        in_tree = [frame for frame in candidates if frame in moved or frame == survey.base]
        return next(iter([*in_tree, *candidates, *moved]), None)

    def _lidars(self, survey: _Survey, base: str | None) -> dict[str, _Lidar]:
        """Lidars to take, by topic.

        Unless they were asked for: one topic of each sensor frame, for another is the same scan again; and
        only lidars at about the height of the one that sees most, for a map shows one plane.
        """
        names = lidar_names([*survey.frames])
        lidars: dict[str, _Lidar] = {}
        frames: set[str] = set()
        plane: float | None = None
        for topic in sorted(survey.frames, key=lambda topic: (-survey.spans[topic], len(topic), topic)):
            frame = survey.frames[topic]
            if frame in frames and not self._options.lidars:
                self.counters["topics_of_the_same_lidar"] += 1
                continue
            matrix = survey.tree.between(base, frame) if base else None
            placed = planar(np.eye(4) if matrix is None else matrix)
            if placed is None:
                self.counters["lidars_tilted"] += 1
                continue
            if matrix is None:
                self.counters["lidars_without_mount"] += 1
            else:
                height = float(matrix[2, 3])
                plane = height if plane is None else plane
                if abs(height - plane) > SAME_PLANE_M and not self._options.lidars:
                    self.counters["lidars_at_another_height"] += 1
                    continue
            frames.add(frame)
            lidars[topic] = _Lidar(names[topic], *placed)
        return lidars

    def _trusted_stamps(self, survey: _Survey) -> set[str]:
        """Topics whose headers' stamps count."""
        offsets = survey.offsets
        if not offsets:
            return set()
        agree = max(offsets.values()) - min(offsets.values()) <= CLOCKS_APART_NS
        trusted = {topic for topic, offset in offsets.items() if agree or abs(offset) <= CLOCKS_APART_NS}
        self.counters["topics_with_another_clock"] += len(offsets) - len(trusted)
        return trusted

    def _convert(
        self,
        messages: Iterator[BagMessage],
        lidars: dict[str, _Lidar],
        base: str | None,
        offsets: dict[str, int],
        trusted: set[str],
    ) -> Iterator[Envelope]:
        for message in messages:
            body = message.message
            if hasattr(body, "transforms"):
                yield from self._odometry_of_transforms(body, base)
                continue
            time = message.time
            if message.topic in trusted:
                header = _stamp(body.header)
                usual = abs(header - message.time - offsets[message.topic]) <= STRAY_STAMP_NS
                self.counters["stray_stamp"] += not usual
                time = header if usual else message.time + offsets[message.topic]
            if time <= 0:
                self.counters["no_stamp"] += 1
            elif message.topic in lidars:
                yield self._scan(body, lidars[message.topic], time)
            else:
                yield from self._odometry(body, time)

    def _scan(self, body: Any, lidar: _Lidar, time: int) -> Envelope:
        increment = float(body.angle_increment)
        if increment == 0.0 and len(body.ranges) > 1:
            increment = (float(body.angle_max) - float(body.angle_min)) / (len(body.ranges) - 1)
        return raw_scan(
            self._options,
            lidar.name,
            time,
            lidar.mount,
            upside_down=lidar.upside_down,
            frame_id=_frame(body.header.frame_id),
            angle_min=float(body.angle_min),
            angle_increment=increment,
            range_min=float(body.range_min),
            range_max=float(body.range_max),
            ranges=np.asarray(body.ranges, dtype=np.float32).tolist(),
        )

    def _odometry(self, body: Any, time: int) -> Iterator[Envelope]:
        pose = body.pose.pose
        placed = _pose(pose.position, pose.orientation)
        if placed is None:
            self.counters["odometry_not_finite"] += 1
            return
        covariance = np.asarray(body.pose.covariance, dtype=np.float64)
        kept = covariance.tolist() if np.isfinite(covariance).all() and covariance.any() else []
        yield odometry(self._options, time, placed, pose_covariance=kept)

    def _odometry_of_transforms(self, body: Any, base: str | None) -> Iterator[Envelope]:
        for item in body.transforms:
            if (_frame(item.header.frame_id), _frame(item.child_frame_id)) != (ODOMETRY_FRAME, base):
                continue
            placed = _pose(item.transform.translation, item.transform.rotation)
            if placed is None:
                self.counters["odometry_not_finite"] += 1
            else:
                yield odometry(self._options, _stamp(item.header), placed)


def lidar_names(topics: list[str]) -> dict[str, str]:
    """A name for each topic, one key chunk: `/front/laser/scan` is `front_laser`, `/scan` is `scan`."""
    names: dict[str, str] = {}
    for topic in topics:
        parts = [part for part in re.split(r"[/*$#?@\s]+", topic) if part]
        if len(parts) > 1 and parts[-1] in ("scan", "laser_scan"):
            parts.pop()
        name = "_".join(parts) or "lidar"
        while name in names.values():
            name += "_"
        names[topic] = name
    return names


def _span(body: Any) -> int:
    """Field of view, deg, rounded: lidars that differ by less see as much."""
    return round(float(np.degrees(abs(body.angle_increment) * len(body.ranges))))


def _hear_transforms(tree: TransformTree, message: Any) -> None:
    for item in message.transforms:
        move, turn = item.transform.translation, item.transform.rotation
        tree.hear(
            _frame(item.header.frame_id),
            _frame(item.child_frame_id),
            (move.x, move.y, move.z),
            (turn.x, turn.y, turn.z, turn.w),
        )


def _pose(position: Any, orientation: Any) -> NDArray[np.float64] | None:
    rotation = rotation_matrix((orientation.x, orientation.y, orientation.z, orientation.w))
    if rotation is None or not np.isfinite([position.x, position.y]).all():
        return None
    return np.array([position.x, position.y, np.arctan2(rotation[1, 0], rotation[0, 0])])


def _frame(name: str) -> str:
    return name.lstrip("/")


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _listed(topics: list[str]) -> str:
    return ", ".join(topics) or "none"
