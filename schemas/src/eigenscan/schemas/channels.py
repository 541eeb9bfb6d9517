"""The one table of all channels: key, message, and how it travels.

A channel's key is a template such as `{site}/robot/{robot}/scan/{lidar}`; its fields are single
key chunks. Keys are built and parsed here and nowhere else.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property, lru_cache
from operator import itemgetter

from eigenscan.schemas.advice_pb2 import Advice
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Obstacles, SearchRequest
from eigenscan.schemas.model_pb2 import LidarKind, ModelSet, RegionModel, RegionSpace
from eigenscan.schemas.scan_pb2 import RawScan, Scan, ScanMotion
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message

CONTRACT_VERSION = 1
"""Counts the breaking changes of the contract; it travels in every sample's encoding."""

DEFAULT_SITE = "site"
DEFAULT_ROBOT = "robot"

MOST_PARSED = 4096
"""Keys of a channel whose addresses are remembered: a sender may invent any number."""

_FIELD = re.compile(r"{(\w+)}")
_CHUNK = re.compile(r"[^/*$#?@\s\x00-\x1f\x7f-\x9f\ud800-\udfff]+")


class ContractError(ValueError):
    """A key or a sample outside this contract."""


def is_chunk(text: str) -> bool:
    """Whether `text` can be one chunk of a key.

    It must not be empty, nor contain any of `/ * $ # ? @`, a blank, a control character, or a byte that is no
    UTF-8 (a surrogate in Python).
    """
    return bool(_CHUNK.fullmatch(text))


class Priority(Enum):
    """Zenoh's priorities that the contract uses, most urgent first."""

    REAL_TIME = "real_time"
    INTERACTIVE_HIGH = "interactive_high"
    DATA = "data"
    DATA_LOW = "data_low"
    BACKGROUND = "background"


class Role(Enum):
    """Kinds of certificates at a site's router."""

    ROBOT = "robot"
    MAPBUILDER = "mapbuilder"
    RECORDER = "recorder"
    OPERATOR = "operator"


@dataclass(frozen=True)
class Qos:
    """Quality of service of a channel.

    `block`: the publisher waits instead of dropping a sample. `express`: samples are never batched, for low
    latency. `latched`: a late subscriber gets the newest sample of each key by a query on that key. `depth`:
    samples that may wait at a subscriber before the oldest is dropped; 0: never dropped. `newest`: a
    subscriber that falls behind skips all but the newest sample of a key. `rate_hz`: usual rate, for health
    and planning. `air_hz`: largest rate over the air between robot and site; 0: it stays on the robot;
    infinite: no limit.
    """

    priority: Priority = Priority.DATA
    block: bool = False
    express: bool = False
    latched: bool = False
    depth: int = 64
    newest: bool = False
    rate_hz: float = 0.0
    air_hz: float = 0.0


@dataclass(frozen=True, eq=False)  # each is one of the table: every message compares a few
class Channel:
    """One kind of message and its keys."""

    name: str
    template: str
    message: type[Message]
    qos: Qos = field(default_factory=Qos)
    about: str = ""
    published_by: tuple[Role, ...] = (Role.ROBOT,)

    @property
    def to_one_robot(self) -> bool:
        """Whether the site publishes it to a robot, on the robot's own key."""
        return "robot" in self.fields and any(role is not Role.ROBOT for role in self.published_by)

    @property
    def received_by(self) -> tuple[Role, ...]:
        """Roles that may receive it through the site's router.

        The site receives all. A robot receives channels that no robot publishes, and the site's messages to
        itself.
        """
        robots = Role.ROBOT not in self.published_by or self.to_one_robot
        return tuple(role for role in Role if role is not Role.ROBOT or robots)

    @cached_property
    def fields(self) -> tuple[str, ...]:
        """Names of the template's fields, in order."""
        return tuple(_FIELD.findall(self.template))

    @cached_property
    def _values(self) -> Callable[[Mapping[str, str]], tuple[str, ...] | str]:
        """Those of an address in the order of `fields`; the value itself where there is one field."""
        return itemgetter(*self.fields)

    @cached_property
    def schema_name(self) -> str:
        """Full protobuf name, such as `eigenscan.Scan`."""
        return str(self.message.DESCRIPTOR.full_name)

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        return re.compile(
            re.sub(r"{(\w+)}", lambda field: f"(?P<{field[1]}>{_CHUNK.pattern})", self.template)
        )

    @cached_property
    def _parsed(self) -> dict[str, dict[str, str]]:
        """Addresses of the last keys, because the same few come with each message."""
        return {}

    def key(self, address: Mapping[str, str]) -> str:
        """Full key for `address`; fields of other channels are ignored.

        Raises ContractError if a field is missing or is not one plain key chunk.
        """
        try:
            return _key(self.name, self.template, self._values(address))
        except KeyError as missing:
            raise ContractError(f"{self.name}: key field {missing} cannot be ''") from missing

    def selector(self, address: Mapping[str, str] | None = None) -> str:
        """Key expression for all keys of this channel with the fields that `address` gives.

        Raises ContractError if a field is neither one plain key chunk nor `*`.
        """
        given = address or {}
        for name in self.fields:
            value = given.get(name, "*")
            if value != "*" and not is_chunk(value):
                raise ContractError(f"{self.name}: key field {name!r} cannot be {value!r}")
        return self.template.format_map({name: given.get(name, "*") for name in self.fields})

    def parse(self, key: str) -> dict[str, str] | None:
        """Address in `key`; None if the key belongs to another channel."""
        known = self._parsed.get(key)
        if known is None:
            match = self._pattern.fullmatch(key)
            if match is None:
                return None
            if len(self._parsed) >= MOST_PARSED:
                self._parsed.clear()
            known = self._parsed[key] = match.groupdict()
        return dict(known)


@lru_cache(maxsize=4096)  # the same few keys come with each message
def _key(channel: str, template: str, values: tuple[str, ...] | str) -> str:
    given = (values,) if isinstance(values, str) else values
    fields = dict(zip(_FIELD.findall(template), given, strict=True))
    for name, value in fields.items():
        if not is_chunk(value):
            raise ContractError(f"{channel}: key field {name!r} cannot be {value!r}")
    return template.format_map(fields)


_LIVE = Qos(Priority.REAL_TIME, express=True, depth=64, rate_hz=40.0)
_SWEEP = replace(_LIVE, newest=True)
_SITE_DATA = Qos(Priority.DATA_LOW, block=True, latched=True, depth=0, air_hz=math.inf)

SCAN_RAW = Channel(
    "scan_raw",
    "{site}/robot/{robot}/scan/raw/{lidar}",
    RawScan,
    _SWEEP,
    "one sweep as the lidar's driver gives it, for scan-ingest",
)
SCAN = Channel(
    "scan",
    "{site}/robot/{robot}/scan/{lidar}",
    Scan,
    _SWEEP,
    "the canonical scan, from scan-ingest, for all others",
)
SCAN_MOTION = Channel(
    "scan_motion",
    "{site}/robot/{robot}/scan/motion/{lidar}",
    ScanMotion,
    Qos(Priority.REAL_TIME, express=True, depth=64, rate_hz=5.0),
    "how the robot moved between two scans, by these alone, from scan-ingest, for the tracker",
)
FOLLOWS = 0.5
"""Share of a scan's beams that the one before it has too, below which it rather is of another place.

Of 22,000 neighbours on seven logs less in 3, of other places more in 0.5 to 28 of 100. With 0.6, 25 of the
neighbours had less: who walks past hides as much (benchmarks/scan_motion.py --pairs 6000).
"""
ODOMETRY = Channel(
    "odometry",
    "{site}/robot/{robot}/odom",
    Odometry,
    Qos(Priority.REAL_TIME, express=True, depth=1024, rate_hz=50.0),
    "the robot's own dead reckoning, for the tracker",
)
HEADING = Channel(
    "heading",
    "{site}/robot/{robot}/heading",
    Heading,
    Qos(Priority.REAL_TIME, express=True, depth=1024, rate_hz=50.0),
    "the heading by a gyroscope, for the tracker; optional",
)
HYPOTHESES = Channel(
    "hypotheses",
    "{site}/robot/{robot}/hypotheses/{lidar}/{projector}",
    Hypotheses,
    _LIVE,
    "where one scan may have been taken, from a projector, for the tracker",
)
SEARCH = Channel(
    "search",
    "{site}/robot/{robot}/search/{lidar}",
    SearchRequest,
    _LIVE,
    "where to search the next scan, from the tracker, for projectors",
)
OBSTACLES = Channel(
    "obstacles",
    "{site}/robot/{robot}/obstacles/{lidar}/{projector}",
    Obstacles,
    Qos(Priority.DATA, rate_hz=40.0),
    "what the best hypothesis does not explain, from a projector",
)
POSE = Channel(
    "pose",
    "{site}/robot/{robot}/pose",
    PoseEstimate,
    # over the air every pose of a 10 Hz lidar, however it jitters, and a fourth of a 40 Hz one's
    Qos(Priority.INTERACTIVE_HIGH, express=True, rate_hz=40.0, air_hz=12.5),
    "the one pose to act on, with its state and confidence, from the tracker",
)
TRACKS = Channel(
    "tracks",
    "{site}/robot/{robot}/tracks",
    Tracks,
    Qos(rate_hz=40.0, air_hz=1.0),
    "all trajectories in play, from the tracker",
)
IN_PLAY = 0.01
"""Probability from which a track comes with its past poses, and is drawn.

The viewer draws a hypothesis from this share of the best one's probability on: more would hide the map.
Most of a robot's dozens of tracks have less. With the past of all a message has 22 kB instead of 6, which
was most of a recording.
"""
ADVICE = Channel(
    "advice",
    "{site}/robot/{robot}/advice/{projector}",
    Advice,
    Qos(rate_hz=1.0, air_hz=1.0),
    "the move that would distinguish ambiguous places, from a projector",
)
TRANSFORM = Channel(
    "transform",
    "{site}/robot/{robot}/tf",
    FrameTransform,
    Qos(Priority.REAL_TIME, express=True, rate_hz=50.0),
    "coordinate frames, for viewers",
)
TRUTH = Channel(
    "truth",
    "{site}/robot/{robot}/truth",
    PoseInFrame,
    Qos(Priority.DATA_LOW, rate_hz=40.0),
    "the true pose if it is known (simulation); only the recorder receives it",
)
RELOCATION = Channel(
    "relocation",
    "{site}/robot/{robot}/relocation",
    Relocation,
    Qos(Priority.INTERACTIVE_HIGH, block=True, express=True),
    "where the robot is, or that it may be anywhere, from an operator, for the tracker",
    (Role.ROBOT, Role.OPERATOR),
)
MAP = Channel(
    "map",
    "{site}/map",
    Grid,
    _SITE_DATA,
    "the occupancy grid that the models were made from",
    (Role.MAPBUILDER,),
)
MODEL = Channel(
    "model",
    "{site}/model/{region}",
    RegionModel,
    _SITE_DATA,
    "the eigenspace of one region, from the mapbuilder, for projectors",
    (Role.MAPBUILDER,),
)
MODEL_SET = Channel(
    "model_set",
    "{site}/models",
    ModelSet,
    _SITE_DATA,
    "which models and map belong together, from the mapbuilder, for projectors",
    (Role.MAPBUILDER,),
)
LIDAR_KIND = Channel(
    "lidar_kind",
    "{site}/robot/{robot}/lidar/{lidar}",
    LidarKind,
    Qos(Priority.DATA_LOW, rate_hz=0.1, air_hz=math.inf),
    "a lidar that lacks eigenspaces",
)
SPACE = Channel(
    "space",
    "{site}/space/{region}/{kind}",
    RegionSpace,
    _SITE_DATA,
    "a region's eigenspace for such lidars",
    (Role.MAPBUILDER,),
)
HEALTH = Channel(
    "health",
    "{site}/health/{service}/{instance}",
    Health,
    Qos(Priority.BACKGROUND, rate_hz=1.0, air_hz=math.inf),
    "how a service instance is, from every service",
    (Role.ROBOT, Role.MAPBUILDER, Role.RECORDER),
)

CHANNELS: tuple[Channel, ...] = (
    SCAN_RAW,
    SCAN,
    SCAN_MOTION,
    ODOMETRY,
    HEADING,
    HYPOTHESES,
    SEARCH,
    OBSTACLES,
    POSE,
    TRACKS,
    ADVICE,
    TRANSFORM,
    TRUTH,
    RELOCATION,
    MAP,
    MODEL,
    MODEL_SET,
    LIDAR_KIND,
    SPACE,
    HEALTH,
)

ALIVE_TEMPLATE = "{site}/alive/{service}/{instance}/{contract}"
"""Key of the liveliness token that each service instance holds."""

LATCHED_TEMPLATE = "{site}/latched/{channel}/{session}"
"""Key of the liveliness token of a session that answers queries for a latched channel."""


RECORDINGS_TEMPLATE = "{site}/recordings/{robot}/{what}"
"""Key on which a robot's recorder answers queries for its files.

`what` is `parts`: which files there are (RecordingParts); or `bytes`: a piece of one (RecordingRequest).
"""

MOST_RECORDED_BYTES = 1_048_576
"""Largest answer: a longer one would delay the robot's other messages."""

LOCALIZE_TEMPLATE = "{site}/localize"
"""Key on which projectors answer a LocalizeQuery with a LocalizeReply."""

MOST_ASKED_BYTES = 131_072
"""Largest query: a scan of 20,000 beams is shorter."""


def find(key: str) -> tuple[Channel, dict[str, str]] | None:
    """Channel and address of a key; None for a foreign key."""
    for channel in CHANNELS:
        address = channel.parse(key)
        if address is not None:
            return channel, address
    return None


def by_name(name: str) -> Channel:
    """Channel called `name`. Raises ContractError if there is none."""
    for channel in CHANNELS:
        if channel.name == name:
            return channel
    known = ", ".join(channel.name for channel in CHANNELS)
    raise ContractError(f"no channel {name!r}; choose one of {known}")
