"""The bridge without its shell: poses become states of VDA 5050, instant actions become relocations."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from eigenscan.geometry.pose import Array, from_message, to_message
from eigenscan.schemas.channels import (
    DEFAULT_ROBOT,
    DEFAULT_SITE,
    HEALTH,
    MODEL_SET,
    POSE,
    RELOCATION,
    Channel,
)
from eigenscan.schemas.envelope import Condition, Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tick import TICK
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation
from eigenscan.schemas.words import state_word
from eigenscan.vda5050 import messages
from eigenscan.vda5050.actions import (
    FACTSHEET_REQUEST,
    LONGEST,
    SET_POSITION,
    STATE_REQUEST,
    Action,
    MessageError,
    actions_of,
    position_of,
    read_message,
)
from eigenscan.vda5050.channels import (
    BROKER,
    FACTSHEET,
    INSTANT_ACTIONS,
    MQTT_PUBLISHED,
    MQTT_RECEIVED,
    ORDER,
    STATE,
    VISUALIZATION,
)
from eigenscan.vda5050.messages import LOCALIZATION_ERROR, Situation
from eigenscan.vda5050.position import Maps, claims, is_finite, position
from eigenscan.vda5050.settings import Vda5050Settings
from google.protobuf.wrappers_pb2 import BytesValue

MOVING_M, MOVING_RAD, OVER_NS = 0.05, 0.05, 500_000_000
"""A robot drives if it moves this far, m or rad, in a second; poses this many ns apart are compared."""


class Vda5050Core:
    """The bridge of one robot. Its messages lack `timestamp`, because only the shell has a clock."""

    inputs: tuple[Channel, ...] = (MQTT_RECEIVED, POSE, MODEL_SET, HEALTH, TICK)
    outputs: tuple[Channel, ...] = (MQTT_PUBLISHED, RELOCATION)

    def __init__(
        self, settings: Vda5050Settings, site: str = DEFAULT_SITE, robot: str = DEFAULT_ROBOT
    ) -> None:
        """`site` and `robot` are those of the keys."""
        self._settings, self._address = settings, {"site": site, "robot": robot}
        self._serial = settings.serial_number or robot
        self._maps = Maps(settings.map_id)
        self._now = Situation(maps=self._maps.ids())
        self._estimate: PoseEstimate | None = None
        self._before: tuple[int, Array] | None = None
        self._silent, self._since_state = settings.stale_s, 0.0  # s
        self._tracker = ""  # why its tracker is degraded
        self._refusal: dict[str, Any] | None = None
        self._broker = "no connection yet"
        self._numbers: Counter[str] = Counter()
        self._last_number: dict[str, int] = {}
        self._shown = 0  # ns, stamp of the pose on the topic visualization
        self._last_state: dict[str, Any] = {}
        self._counts: Counter[str] = Counter()

    def start(self) -> Iterable[Envelope]:
        """Publishes nothing before a broker is connected."""
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing is held back."""
        return ()

    def condition(self) -> Condition:
        """Waiting without a broker, or without a tracker."""
        counts = dict(self._counts)
        if self._broker:
            return Condition(Health.STATUS_WAITING, f"broker: {self._broker}", counts)
        if self._is_silent:
            return Condition(Health.STATUS_WAITING, "no pose arrives from the tracker", counts)
        return Condition(Health.STATUS_OK, "", counts)

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """Follows the tracker; answers fleet managers."""
        published: list[Envelope] = []
        if received.channel is MQTT_RECEIVED:
            published += self._receive_broker(received.address["topic"], received.open(BytesValue).value)
        elif received.channel == POSE:
            published += self._receive_pose(received.open(PoseEstimate))
        elif received.channel == MODEL_SET:
            message = received.open(ModelSet)
            self._maps = self._maps.with_models(message)
            self._now.maps, self._now.map_version = self._maps.ids(), message.map_version
        elif received.channel == HEALTH:
            self._receive_health(received.address, received.open(Health))
        elif received.channel is TICK:
            self._tick()
        published += self._state_if_due()
        return published

    @property
    def _is_silent(self) -> bool:
        return self._silent >= self._settings.stale_s

    @property
    def _localized(self) -> bool:
        """Whether the tracker claims, now."""
        return claims(self._estimate) and not self._is_silent

    def _tick(self) -> None:
        self._silent += 1
        self._since_state += 1.0
        if self._is_silent:  # as before the first pose
            self._now.driving, self._before = False, None
        for action in self._now.actions.setting:
            action.ticks += 1
            if action.ticks >= self._settings.position_s:
                action.end("FAILED", f"no pose was claimed within {self._settings.position_s} s")

    def _receive_pose(self, estimate: PoseEstimate) -> Iterator[Envelope]:
        self._silent = 0
        if not is_finite(estimate):
            self._counts["set_aside_pose_not_finite"] += 1
            self._estimate = None
            return
        self._estimate = estimate
        pose, at = from_message(estimate.pose), nanoseconds(estimate.timestamp)
        self._drive(at, pose)
        for action in self._now.actions.setting:
            action.receive(estimate, pose)
        hz = self._settings.visualization_hz
        if hz and not 0 <= at - self._shown < 1e9 / hz:
            self._shown = at
            yield from self._visualization()

    def _drive(self, at: int, pose: Array) -> None:
        if self._before is None or not 0 <= at - self._before[0] < 10 * OVER_NS:
            self._before = at, pose
        elif at - self._before[0] >= OVER_NS:
            seconds, off = (at - self._before[0]) * 1e-9, pose - self._before[1]
            turned = abs(float(np.arctan2(np.sin(off[2]), np.cos(off[2]))))
            driven = float(np.hypot(off[0], off[1]))
            self._now.driving = driven > MOVING_M * seconds or turned > MOVING_RAD * seconds
            self._before = at, pose

    def _receive_health(self, address: Mapping[str, str], health: Health) -> None:
        if address["service"] == "tracker" and address["instance"] == self._address["robot"]:
            degraded = health.status == Health.STATUS_DEGRADED
            self._tracker = (health.detail or "the tracker is degraded") if degraded else ""

    def _receive_broker(self, topic: str, data: bytes) -> Iterator[Envelope]:
        if topic == BROKER:
            self._broker = data.decode()
            if not self._broker:
                self._last_state = {}  # a new subscriber knows nothing
                yield from self._publish_factsheet()
            return
        if self._settings.only_visualization:
            return
        try:
            published = read_message(data, self._settings.major, self._settings.manufacturer, self._serial)
            listed = actions_of(published) if topic == INSTANT_ACTIONS else []
        except MessageError as error:
            self._counts[f"set_aside_{topic}"] += 1
            self._refuse("VALIDATION_FAILURE", f"{topic}: {error}")
            return
        self._check_number(topic, published["headerId"])
        if topic == ORDER:
            self._counts["refused_orders"] += 1
            reference = {"orderId": str(published.get("orderId", ""))[:LONGEST]}
            self._refuse("MOBILE_ROBOT_NOT_AVAILABLE", "the localizer takes no orders", **reference)
            return
        self._refusal = None
        for one in listed:
            yield from self._act(one)

    def _check_number(self, topic: str, number: int) -> None:
        """Counts messages that were lost or come again; they are taken all the same."""
        last = self._last_number.get(topic)
        if last is not None and number <= last:
            self._counts["header_id_not_increasing"] += 1
        elif last is not None and number > last + 1:
            self._counts["header_id_gaps"] += 1
        self._last_number[topic] = number

    def _act(self, published: dict[str, Any]) -> Iterator[Envelope]:
        kind, name = published["actionType"], published["actionId"]
        if name in self._now.actions:
            self._counts["repeated_actions"] += 1
            return
        action = Action(name, kind)
        if kind in SET_POSITION:
            yield from self._set_position(action, published)
        elif kind == FACTSHEET_REQUEST:
            action.end("FINISHED")
            yield from self._publish_factsheet()
        elif kind == STATE_REQUEST:
            action.end("FINISHED")
            self._last_state = {}
        else:
            action.end("FAILED", f"{kind!r:.60} is not supported by the localizer")
            self._counts["unsupported_actions"] += 1
            self._refuse("INVALID_INSTANT_ACTION", action.result, actionId=name)
        self._now.actions.add(action)

    def _set_position(self, action: Action, published: dict[str, Any]) -> Iterator[Envelope]:
        try:
            map_id, pose, node = position_of(published)
            try:
                target = self._maps.to_site(map_id, pose)
            except KeyError:
                known = ", ".join(self._maps.ids())
                raise MessageError(f"mapId: {map_id!r:.60} is none of: {known}") from None
        except MessageError as error:
            self._counts["set_aside_positions"] += 1
            action.end("FAILED", str(error))
            self._refuse("INVALID_INSTANT_ACTION", str(error), actionId=action.name)
            return
        action.target = target
        self._now.last_node = node or self._now.last_node
        word = Relocation(frame_id=self._maps.frame, pose=to_message(target))
        if self._estimate is not None:
            word.timestamp.CopyFrom(self._estimate.timestamp)
        yield Envelope(RELOCATION, self._address, word)

    def _refuse(self, kind: str, words: str, **references: str) -> None:
        """Reports the error in the state until a message is accepted."""
        self._refusal = messages.error(kind, "WARNING", words, **references)

    def _visualization(self) -> Iterator[Envelope]:
        fields = position(self._estimate, self._maps, self._localized, self._settings.major)
        if fields is None:
            return
        body: dict[str, Any] = {messages.position_field(self._settings): fields}
        if self._settings.major == 3:
            body["referenceStateHeaderId"] = max(self._numbers[STATE] - 1, 0)
        yield from self._publish(VISUALIZATION, body)

    def _publish_factsheet(self) -> Iterator[Envelope]:
        if not self._settings.only_visualization:
            yield from self._publish(FACTSHEET, messages.factsheet(self._settings))

    def _state_if_due(self) -> Iterator[Envelope]:
        """The state, where more than the position has changed, or it is time."""
        if self._settings.only_visualization or self._broker:
            return
        now = self._now
        now.position = position(self._estimate, self._maps, self._localized, self._settings.major)
        now.errors = [*self._localization_errors(), *([self._refusal] if self._refusal else [])]
        fields = messages.state(now, self._settings)
        field = messages.position_field(self._settings)
        lasting = {key: value for key, value in fields.items() if key != field}
        lasting[field] = self._localized, (now.position or {}).get("mapId")
        if lasting == self._last_state and self._since_state < self._settings.state_interval:
            return
        self._last_state, self._since_state = lasting, 0.0
        yield from self._publish(STATE, fields)

    def _localization_errors(self) -> list[dict[str, Any]]:
        if self._localized:
            words, level = self._tracker, "WARNING"
        else:
            words, level = ": ".join(filter(None, (self._not_localized(), self._tracker))), "FATAL"
        return [messages.error(LOCALIZATION_ERROR, level, words)] if words else []

    def _not_localized(self) -> str:
        """Why, in words."""
        if self._is_silent:
            return f"no pose arrived for {self._settings.stale_s} s"
        if self._estimate is None:
            return "the pose is not finite"
        return state_word(self._estimate.state)

    def _publish(self, topic: str, body: dict[str, Any]) -> Iterator[Envelope]:
        if self._broker:
            return
        header = {
            "headerId": self._numbers[topic],
            "version": self._settings.version,
            "manufacturer": self._settings.manufacturer,
            "serialNumber": self._serial,
        }
        self._numbers[topic] += 1
        data = json.dumps(header | body, allow_nan=False).encode()
        yield Envelope(MQTT_PUBLISHED, {"topic": topic}, BytesValue(value=data))
