"""Reads the beginning of a ROS bag for its lidars and mounts, its odometry, and the right clock."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from eigenscan.geometry.transforms import TransformTree, planar
from eigenscan.ros_bridge.inbound import frame_name, header_stamp, lidar_names
from eigenscan.workbench.logs.bag import LASER_SCAN, MULTI_ECHO, ODOMETRY_MESSAGE, TRANSFORMS, Bag, BagMessage
from eigenscan.workbench.logs.log import LogError, LogOptions
from eigenscan.workbench.logs.pace import Stamped
from numpy.typing import NDArray

CLOCKS_APART_NS = 1_000_000_000
SAME_PLANE_M = 0.5
UNSTAMPED = 10
"""Messages of a topic that show that none has a stamp: a lone 0 is the start of simulated time."""
USUAL_BASES = ("base_footprint", "base_link", "base", "base_frame")
ODOMETRY_FRAME = re.compile(r"(.*/)?odom\w*|.*[/_]odom")
"""Such as odom, robot_0/odom, odom_combined, wheel_odom."""
NO_ODOMETRY = re.compile(r"truth|gazebo|slam|amcl|map", re.IGNORECASE)
CLOUD = "sensor_msgs/msg/PointCloud2"
NAMED = 10
"""Topics of a bag that a message names."""
MOVES = "tf"
"""Name among the topics for odometry in the form of transforms."""


@dataclass(frozen=True)
class Lidar:
    """One lidar of the log: its name, its frame, and its mount on the base."""

    name: str
    frame: str
    mount: NDArray[np.float64]
    upside_down: bool


@dataclass(frozen=True)
class Plan:
    """How a bag is to be converted."""

    lidars: dict[str, Lidar]  # by topic
    odometry: list[str]  # topics of it: one of Odometry, or those of transforms
    base: str | None
    moves_in: str | None  # frame of odometry in the form of transforms
    stamped: dict[str, Stamped]  # a message of each topic whose headers' stamps count


@dataclass
class Survey:
    """Messages received so far."""

    options: LogOptions
    tree: TransformTree = field(default_factory=TransformTree)
    frames: dict[str, str] = field(default_factory=dict)  # by lidar topic
    spans: dict[str, int] = field(default_factory=dict)  # deg, field of view by lidar topic
    # the newest message with a stamp by topic; None: there was none yet
    stamped: dict[str, Stamped | None] = field(default_factory=dict)
    unstamped: Counter[str] = field(default_factory=Counter)  # messages without one, by topic
    # odometry frame, and message as above, by the frame that transforms state moves in it
    moves: dict[str, tuple[str, Stamped | None]] = field(default_factory=dict)
    moved: str | None = None  # the frame that Odometry names as its child

    @property
    def base(self) -> str | None:
        """The robot's base frame, as far as it is known."""
        if self.options.base_frame or self.moved:
            return self.options.base_frame or self.moved
        usual = [
            frame
            for name in USUAL_BASES
            for frame in self.tree.frames()
            if frame == name or frame.endswith("/" + name)
        ]
        moved = [frame for frame in usual if frame in self.moves]
        return next(iter([*moved, *usual, *self.moves]), None)

    def receive(self, message: BagMessage) -> None:
        """Takes note of a message."""
        body = message.message
        if hasattr(body, "transforms"):
            for item in body.transforms:
                self._receive_transform(item, message.time)
            return
        stamped = _stamped(body.header, message.time)
        self.unstamped[message.topic] += stamped is None
        is_new = message.topic not in self.stamped
        self.stamped[message.topic] = stamped or self.stamped.get(message.topic)
        if is_new:
            if hasattr(body, "ranges"):
                self.frames[message.topic] = frame_name(body.header.frame_id)
                self.spans[message.topic] = _span(body)
            else:
                self.moved = frame_name(body.child_frame_id) or None

    def complete(self, lidars: Collection[str], odometry: str | None) -> bool:
        """Whether nothing is left to find out."""
        base = self.base
        if len(self.frames) < len(lidars) or base is None:
            return False
        if any(self.unstamped[topic] < UNSTAMPED for topic, found in self.stamped.items() if not found):
            return False
        moves = base in self.moves if odometry is None else odometry in self.stamped
        return moves and all(self.tree.between(base, frame) is not None for frame in self.frames.values())

    def _receive_transform(self, item: Any, recorded: int) -> None:
        move, turn = item.transform.translation, item.transform.rotation
        parent, child = frame_name(item.header.frame_id), frame_name(item.child_frame_id)
        self.tree.receive(parent, child, (move.x, move.y, move.z), (turn.x, turn.y, turn.z, turn.w))
        if ODOMETRY_FRAME.fullmatch(parent):
            first, known = self.moves.get(child, (parent, None))
            self.moves[child] = first, _stamped(item.header, recorded) or known


def survey_bag(bag: Bag, options: LogOptions, counters: Counter[str]) -> Plan:
    """Reads until every lidar has a scan and a transform to the base, or to the end.

    Skipped messages are counted. Raises LogError if there is no usable lidar, or not the requested one.
    """
    kinds = bag.topics()
    of_kind = {name: [topic for topic, kind in kinds.items() if kind == name] for name in kinds.values()}
    scans = of_kind.get(LASER_SCAN, []) + of_kind.get(MULTI_ECHO, [])
    if not scans:
        raise LogError(f"{bag.path}: holds no laser scan, or was cut before the first: {_others(kinds)}")
    lidars = _choose_lidars(bag, options, scans)
    odometry = _choose_odometry(bag, options, of_kind.get(ODOMETRY_MESSAGE, []))
    transforms = of_kind.get(TRANSFORMS, [])
    survey = Survey(options)
    for message in bag.messages([*lidars, *transforms, *([odometry] if odometry else [])]):
        survey.receive(message)
        if survey.complete(lidars, odometry):
            break
    _check_base(bag, survey)
    placed = _place(survey, counters)
    if not survey.frames and bag.counters["truncated_file"]:
        raise LogError(f"{bag.path}: is damaged, or was cut, before the first laser scan: record it again")
    if not placed:
        raise LogError(f"{bag.path}: holds no horizontal laser scan ({LASER_SCAN}) that can be read")
    stamped = {topic: survey.stamped[topic] for topic in (*placed, odometry) if topic in survey.stamped}
    moves_in = None
    if odometry is None and survey.base in survey.moves:
        moves_in, stamped[MOVES] = survey.moves[survey.base]
    trusted = _trusted(stamped)
    counters["topics_stamped_by_recording"] += len(stamped) - len(trusted)
    return Plan(placed, [odometry] if odometry else transforms, survey.base, moves_in, trusted)


def _check_base(bag: Bag, survey: Survey) -> None:
    """Raises LogError if no transform has the requested base frame."""
    base, known = survey.options.base_frame, survey.tree.frames()
    if base is not None and base != survey.moved and known and base not in known:
        raise LogError(f"{bag.path}: no frame {base} in tf: choose one of {_listed(sorted(known))}")


def _choose_odometry(bag: Bag, options: LogOptions, topics: list[str]) -> str | None:
    if options.odometry is not None:
        if options.odometry not in topics:
            known = _listed(topics)
            raise LogError(f"{bag.path}: no odometry topic {options.odometry}: choose one of {known}")
        return options.odometry
    raw = [topic for topic in topics if not NO_ODOMETRY.search(topic)]
    return min(raw, key=lambda topic: ("odom" not in topic, len(topic), topic), default=None)


def _choose_lidars(bag: Bag, options: LogOptions, topics: list[str]) -> list[str]:
    names = lidar_names(topics)
    missing = sorted(set(options.lidars) - set(topics) - set(names.values()))
    if missing:
        raise LogError(f"{bag.path}: no lidar {missing[0]}: topics of {LASER_SCAN}: {_listed(topics)}")
    asked = set(options.lidars)
    return [topic for topic in topics if not asked or {topic, names[topic]} & asked]


def _place(survey: Survey, counters: Counter[str]) -> dict[str, Lidar]:
    """Lidars to take, by topic.

    Unless they were asked for: one topic of each sensor frame, for another is the same scan again; only
    lidars that tf places on the base, if any; and only those at about the height of the one that sees most,
    for a map shows one plane.
    """
    asked, base = bool(survey.options.lidars), survey.base
    names = lidar_names([*survey.frames])
    on_base = {
        topic: survey.tree.between(base, frame) if base else None for topic, frame in survey.frames.items()
    }
    is_one = any(matrix is not None for matrix in on_base.values())
    lidars: dict[str, Lidar] = {}
    frames: set[str] = set()
    plane: float | None = None
    for topic in sorted(survey.frames, key=lambda topic: (-survey.spans[topic], len(topic), topic)):
        frame, matrix = survey.frames[topic], on_base[topic]
        is_given = names[topic] in survey.options.mounts
        placed = planar(np.eye(4) if matrix is None or is_given else matrix)
        height = plane if matrix is None else float(matrix[2, 3])
        elsewhere = plane is not None and height is not None and abs(height - plane) > SAME_PLANE_M
        if frame in frames and not asked:
            counters["topics_of_the_same_lidar"] += 1
        elif matrix is None and is_one and not is_given and not asked:  # it may be another robot's
            counters["lidars_off_the_base"] += 1
        elif placed is None:
            counters["lidars_tilted"] += 1
        elif elsewhere and not asked:
            counters["lidars_at_another_height"] += 1
        else:
            counters["lidars_without_mount"] += matrix is None and not is_given
            plane = height if plane is None else plane
            frames.add(frame)
            lidars[topic] = Lidar(names[topic], frame, *placed)
    return lidars


def _trusted(newest: dict[str, Stamped | None]) -> dict[str, Stamped]:
    """Those of the topics with trusted headers: all if the clocks agree, else those near the recorder's."""
    stamped = {topic: found for topic, found in newest.items() if found is not None}
    offsets = [found.offset for found in stamped.values()]
    agree = not stamped or max(offsets) - min(offsets) <= CLOCKS_APART_NS
    if agree and len(stamped) == len(newest):
        return stamped
    return {topic: found for topic, found in stamped.items() if abs(found.offset) <= CLOCKS_APART_NS}


def _stamped(header: Any, recorded: int) -> Stamped | None:
    stamp = header_stamp(header)
    return Stamped(recorded, stamp) if stamp > 0 else None


def _span(body: Any) -> int:
    """Field of view, deg, rounded: lidars that differ by less see as much."""
    span = float(np.degrees(abs(body.angle_increment) * len(body.ranges)))
    return round(span) if np.isfinite(span) else 0


def _others(kinds: dict[str, str]) -> str:
    """What a bag without a laser scan has, and what to do."""
    fix = "record the lidar's topic"
    if CLOUD in kinds.values():
        fix = "make laser scans of the point cloud, with pointcloud_to_laserscan, and record them"
    shown = [f"{topic} ({kind})" for topic, kind in sorted(kinds.items())]
    more = f" and {len(shown) - NAMED} more" if len(shown) > NAMED else ""
    return f"{fix}; its topics: {_listed(shown[:NAMED])}{more}"


def _listed(topics: list[str]) -> str:
    return ", ".join(topics) or "none"
