"""What fleet managers read and publish, without a broker: both versions, each field as the tracker has it."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import jsonschema
import numpy as np
import pytest
from eigenscan.geometry.pose import compose, from_message, to_message
from eigenscan.schemas.channels import HEALTH, MODEL_SET, POSE, RELOCATION
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.geometry_pb2 import Covariance3
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tick import tick
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    PoseEstimate,
    Relocation,
    State,
)
from eigenscan.vda5050.actions import KEPT
from eigenscan.vda5050.channels import MQTT_PUBLISHED, MQTT_RECEIVED
from eigenscan.vda5050.core import Vda5050Core
from eigenscan.vda5050.settings import Vda5050Settings, Version
from google.protobuf.wrappers_pb2 import BytesValue

from tests.services.vda5050.schemas import check

MS = 1_000_000
HERE = (3.0, -2.0, 0.5)
UP = np.array([5.0, 42.0, math.pi / 2])
"""Origin of the upper floor's own map frame in the site's."""


@dataclass
class Manager:
    """A fleet manager that reads all topics, and the pipeline on the other side of the bridge."""

    version: Version
    core: Vda5050Core
    at: int = 1_000 * MS
    number: int = 0
    topics: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    words: list[Relocation] = field(default_factory=list)
    sent: dict[str, Any] = field(default_factory=dict)

    @property
    def major(self) -> int:
        return int(self.version[0])

    def take(self, output: Iterable[Envelope]) -> None:
        for one in output:
            if one.channel is RELOCATION:
                self.words.append(one.open(Relocation))
                continue
            assert one.channel is MQTT_PUBLISHED
            body = json.loads(one.open(BytesValue).value)
            check(one.address["topic"], {"timestamp": "2026-11-22T12:00:00.000Z", **body}, self.major)
            self.topics.setdefault(one.address["topic"], []).append(body)

    def receive(self, topic: str, data: bytes) -> None:
        self.take(self.core.handle(Envelope(MQTT_RECEIVED, {"topic": topic}, BytesValue(value=data))))

    def publish(self, *actions: dict[str, Any], topic: str = "instantActions", **changes: Any) -> None:
        self.number += 1
        reported = {
            "headerId": self.number,
            "timestamp": "2026-11-22T12:00:00Z",
            "version": self.version,
            "manufacturer": "eigenscan",
            "serialNumber": "r1",
            "actions": list(actions),
        }
        self.sent = reported | changes
        self.receive(topic, json.dumps(self.sent).encode())

    def pose(self, state: State = STATE_LOCALIZED, pose: Iterable[float] = HERE, **fields: Any) -> None:
        self.at += 100 * MS
        usual = {"confidence": 0.97, "track_id": 1, "protection_radius": 0.4, "frame_id": "map"}
        known: dict[str, Any] = usual | fields
        reported = PoseEstimate(**known)
        reported.timestamp.CopyFrom(stamp(self.at))
        reported.state = state
        reported.pose.CopyFrom(to_message(np.array(list(pose))))
        self.take(self.core.handle(Envelope(POSE, {"site": "s", "robot": "r1"}, reported)))

    def wait(self, seconds: int) -> None:
        for _ in range(seconds):
            self.take(self.core.handle(tick(self.at)))

    @property
    def state(self) -> dict[str, Any]:
        return self.topics["state"][-1]

    @property
    def position(self) -> dict[str, Any]:
        found: dict[str, Any] = self.state["agvPosition" if self.major == 2 else "mobileRobotPosition"]
        return found

    @property
    def is_localized(self) -> bool:
        return bool(self.position["positionInitialized" if self.major == 2 else "localized"])

    @property
    def errors(self) -> list[tuple[str, str]]:
        return [(one["errorType"], one["errorLevel"]) for one in self.state["errors"]]

    def action(self, name: str) -> dict[str, str]:
        listed = self.state["actionStates" if self.major == 2 else "instantActionStates"]
        (found,) = [one for one in listed if one["actionId"] == name]
        return dict(found)


def set_position(name: str = "a1", map_id: str = "map", major: int = 3, **changes: Any) -> dict[str, Any]:
    known = {"x": HERE[0], "y": HERE[1], "theta": HERE[2], "mapId": map_id, "lastNodeId": "n7"} | changes
    return {
        "actionType": "initPosition" if major == 2 else "initializePosition",
        "actionId": name,
        "blockingType": "NONE",
        "actionParameters": [{"key": key, "value": value} for key, value in known.items()],
    }


def manager_of(version: Version, **settings: Any) -> Manager:
    core = Vda5050Core(Vda5050Settings(version=version, **settings), "s", "r1")
    reported = Manager(version, core)
    reported.receive("broker", b"")
    return reported


@pytest.fixture(params=["2.1.0", "3.0.0"])
def manager(request: pytest.FixtureRequest) -> Manager:
    return manager_of(request.param)


def test_it_is_localized_exactly_while_the_tracker_claims(manager: Manager) -> None:
    claimed = [True, False, True, True, False, False, True]
    shown = []
    for number, claim in enumerate(claimed):
        away = (STATE_LOST, STATE_AMBIGUOUS)[number % 2]
        manager.pose(STATE_LOCALIZED if claim else away)
        shown.append(manager.is_localized)
        assert (("LOCALIZATION_ERROR", "FATAL") in manager.errors) == (not claim)
    assert shown == claimed


def test_position_score_and_deviation_are_the_trackers(manager: Manager) -> None:
    manager.pose(confidence=0.93, protection_radius=0.37)
    assert manager.position["mapId"] == "map"
    assert [manager.position[name] for name in ("x", "y", "theta")] == pytest.approx(HERE)
    assert manager.position["localizationScore"] == 0.93
    assert manager.position["deviationRange"] == 0.37
    shown = manager.topics["visualization"][-1]
    assert shown["agvPosition" if manager.major == 2 else "mobileRobotPosition"] == manager.position
    manager.pose(STATE_LOST, confidence=0.2)
    manager.wait(1)
    assert manager.position["localizationScore"] == 0.2
    assert "deviationRange" not in manager.position


def test_without_a_protection_level_the_deviation_is_what_the_covariance_allows(manager: Manager) -> None:
    covariance = Covariance3(xx=0.04, yy=0.01, tt=0.001)
    manager.pose(covariance=covariance, protection_radius=None, protection_risk=0.01)
    draws = np.random.default_rng(1).normal(0.0, [0.2, 0.1], (100_000, 2))
    assert np.mean(np.hypot(*draws.T) > manager.position["deviationRange"]) <= 0.01
    assert manager.position["deviationRange"] < 4 * 0.2
    manager.pose(protection_radius=None)
    manager.wait(1)
    assert "deviationRange" not in manager.position


@pytest.mark.parametrize("how", ["silence", "not finite"])
def test_a_claim_ends_with_the_poses(manager: Manager, how: str) -> None:
    manager.pose()
    assert manager.is_localized
    if how == "silence":
        manager.wait(1)
        assert manager.is_localized
        manager.wait(1)
        assert not manager.is_localized
        assert manager.core.condition().status == Health.STATUS_WAITING
    else:
        manager.pose(pose=(math.nan, 0.0, 0.0))
        assert manager.core.condition().counters["set_aside_pose_not_finite"] == 1
        assert "agvPosition" not in manager.state
        assert "mobileRobotPosition" not in manager.state
    assert ("LOCALIZATION_ERROR", "FATAL") in manager.errors
    manager.pose()
    assert manager.is_localized
    assert manager.errors == []


def test_a_state_of_a_later_release_is_reported_as_unknown(manager: Manager) -> None:
    """No state was published any more."""
    manager.pose(99)  # type: ignore[arg-type]
    assert not manager.is_localized
    (found,) = manager.state["errors"]
    assert "unknown" in found["errorDescription"]


def test_a_deviation_beyond_all_numbers_is_left_out(manager: Manager) -> None:
    manager.pose(covariance=Covariance3(xx=1e308, yy=1e308, tt=1.0), protection_radius=None)
    assert manager.is_localized
    assert "deviationRange" not in manager.position


@pytest.mark.parametrize("key", [[], {}, None, 1])
def test_a_parameter_without_a_name_is_left_out(manager: Manager, key: object) -> None:
    manager.pose()
    action = set_position(major=manager.major)
    action["actionParameters"].append({"key": key, "value": 1})
    manager.publish(action)
    assert len(manager.words) == 1


def test_a_message_of_very_many_actions_is_refused(manager: Manager) -> None:
    """Each of 4,300 was answered by a factsheet."""
    asked = [{"actionType": "factsheetRequest", "actionId": str(number)} for number in range(33)]
    before = len(manager.topics["factsheet"])
    manager.publish(*asked)
    assert len(manager.topics["factsheet"]) == before
    assert manager.core.condition().counters["set_aside_instantActions"] == 1
    manager.publish(*asked[:32])
    assert len(manager.topics["factsheet"]) == before + 32


def test_before_any_pose_none_is_published(manager: Manager) -> None:
    assert "agvPosition" not in manager.state
    assert "mobileRobotPosition" not in manager.state
    assert manager.errors == [("LOCALIZATION_ERROR", "FATAL")]
    manager.pose(STATE_LOST, track_id=0)
    assert "visualization" not in manager.topics


def test_a_degraded_tracker_is_an_error_with_its_own_words(manager: Manager) -> None:
    manager.pose()
    for instance, words in (("r2", "lidar of another robot"), ("r1", "lidar front is frozen")):
        health = Health(service="tracker", instance=instance, status=Health.STATUS_DEGRADED, detail=words)
        address = {"site": "s", "service": "tracker", "instance": instance}
        manager.take(manager.core.handle(Envelope(HEALTH, address, health)))
    assert manager.errors == [("LOCALIZATION_ERROR", "WARNING")]
    assert manager.state["errors"][0]["errorDescription"] == "lidar front is frozen"
    manager.pose(STATE_LOST)
    assert manager.state["errors"][0]["errorDescription"] == "lost: lidar front is frozen"


def test_a_state_comes_at_each_change_and_once_a_second(manager: Manager) -> None:
    manager.pose()
    count = len(manager.topics["state"])
    for _ in range(5):
        manager.pose()
    assert len(manager.topics["state"]) == count
    manager.wait(1)
    assert len(manager.topics["state"]) == count + 1
    numbers = [one["headerId"] for one in manager.topics["state"]]
    assert numbers == list(range(len(numbers)))


def floors(manager: Manager) -> None:
    message = ModelSet(frame_id="map", map_version="v1")
    for name, origin in (("ground", np.zeros(3)), ("first", UP)):
        message.floors.add(name=name, origin=to_message(origin))
    message.floors.add(name="broken").origin.x = math.nan
    manager.take(manager.core.handle(Envelope(MODEL_SET, {"site": "s"}, message)))


def test_with_floors_the_map_is_the_floor_and_the_position_is_in_its_frame(manager: Manager) -> None:
    floors(manager)
    own = np.array(HERE)
    manager.pose(pose=compose(UP, own), floor="first", floor_pose=to_message(own))
    assert manager.position["mapId"] == "first"
    assert [manager.position[name] for name in ("x", "y", "theta")] == pytest.approx(HERE)
    assert [one["mapId"] for one in manager.state["maps"]] == ["ground", "first"]
    manager.publish(set_position(map_id="first", major=manager.major))
    (word,) = manager.words
    assert from_message(word.pose) == pytest.approx(compose(UP, own))
    assert word.frame_id == "map"


def test_a_position_that_the_scans_confirm_is_finished(manager: Manager) -> None:
    manager.pose(pose=(9.0, 9.0, 0.0))
    manager.publish(set_position(major=manager.major))
    check("instantActions", manager.sent, manager.major)
    (word,) = manager.words
    assert from_message(word.pose) == pytest.approx(HERE)
    assert manager.action("a1")["actionStatus"] == "RUNNING"
    assert manager.state["lastNodeId"] == "n7"
    manager.pose(pose=(9.0, 9.0, 0.0))  # was under way
    assert manager.action("a1")["actionStatus"] == "RUNNING"
    manager.pose(STATE_AMBIGUOUS)
    assert manager.action("a1")["actionStatus"] == "RUNNING"
    manager.pose(pose=(3.3, -2.2, 0.4))
    assert manager.action("a1")["actionStatus"] == "FINISHED"
    assert manager.is_localized


def test_a_position_that_the_scans_contradict_has_failed(manager: Manager) -> None:
    manager.publish(set_position(major=manager.major))
    manager.pose(STATE_LOST)
    manager.pose(pose=(9.0, 9.0, 0.0))
    reported = manager.action("a1")
    assert reported["actionStatus"] == "FAILED"
    assert "scans contradict" in reported["resultDescription" if manager.major == 2 else "actionResult"]


def test_a_position_without_a_claim_fails_in_the_end_and_a_newer_one_replaces_it(manager: Manager) -> None:
    manager.publish(set_position("a1", major=manager.major))
    manager.publish(set_position("a2", major=manager.major))
    assert manager.action("a1")["actionStatus"] == "FAILED"
    manager.wait(29)
    assert manager.action("a2")["actionStatus"] == "RUNNING"
    manager.wait(1)
    assert manager.action("a2")["actionStatus"] == "FAILED"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"mapId": "attic"}, "mapId: 'attic' is none of: map"),
        ({"mapId": 7}, "mapId: 7 is no text"),
        ({"x": "near the door"}, "x: 'near the door' is no number"),
        ({"y": None}, "y: None is no number"),
        ({"theta": True}, "theta: True is no number"),
        ({"x": 1e300}, "x: 1e+300 is no number"),
    ],
)
def test_a_position_that_is_none_moves_nobody(manager: Manager, change: dict[str, Any], words: str) -> None:
    manager.pose()
    manager.publish(set_position(major=manager.major, **change))
    assert manager.words == []
    reported = manager.action("a1")
    assert reported["actionStatus"] == "FAILED"
    assert words in reported["resultDescription" if manager.major == 2 else "actionResult"]
    assert ("INVALID_INSTANT_ACTION", "WARNING") in manager.errors
    assert manager.is_localized
    manager.publish(set_position("a2", major=manager.major))
    assert len(manager.words) == 1
    assert manager.errors == []


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"{", "is no JSON"),
        (b"\xff\xfe", "is no JSON"),
        (b"[]", "is no JSON object"),
        (b"[" * 100_000, "is no JSON"),
        (b'{"headerId": NaN}', "NaN is no number"),
        (b'{"headerId": "7"}', "headerId: '7' is no integer"),
        (b'{"headerId": 1}', "version: None"),
        (b'{"headerId": 1, "version": "1.1"}', "version: '1.1'"),
    ],
)
def test_what_is_no_message_is_counted_and_reported_and_nothing_else(
    manager: Manager, data: bytes, words: str
) -> None:
    manager.pose()
    manager.receive("instantActions", data)
    assert manager.core.condition().counters["set_aside_instantActions"] == 1
    assert manager.errors == [("VALIDATION_FAILURE", "WARNING")]
    assert words in manager.state["errors"][0]["errorDescription"]
    assert manager.is_localized
    manager.publish({"actionType": "stateRequest", "actionId": "q", "blockingType": "NONE"})
    assert manager.errors == []


@pytest.mark.parametrize(
    "changes",
    [
        {"serialNumber": "r2"},
        {"manufacturer": "another"},
        {"actions": "all"},
        {"actions": [7]},
        {"actions": [{"actionId": "a"}]},
        {"actions": [{"actionType": "stateRequest", "actionId": 7}]},
    ],
    ids=str,
)
def test_a_message_for_another_robot_or_without_actions_does_nothing(
    manager: Manager, changes: dict[str, Any]
) -> None:
    manager.publish(**changes)
    assert manager.core.condition().counters["set_aside_instantActions"] == 1
    assert ("VALIDATION_FAILURE", "WARNING") in manager.errors


def test_wrong_header_numbers_are_counted_and_no_action_is_lost_or_done_twice(manager: Manager) -> None:
    action = set_position(major=manager.major)
    manager.publish(action, headerId=5)
    manager.publish(action, headerId=5)
    manager.publish(set_position("a2", major=manager.major), headerId=3)
    manager.publish(set_position("a3", major=manager.major), headerId=9)
    assert len(manager.words) == 3
    counters = manager.core.condition().counters
    assert (counters["header_id_not_increasing"], counters["header_id_gaps"]) == (2, 1)
    assert counters["repeated_actions"] == 1


@pytest.mark.parametrize("turns", [-1, 0, 1, 2])
@pytest.mark.parametrize("heading", [-3.0, -0.5, 2.0, math.pi])
def test_a_heading_is_the_same_one_whatever_turns_a_tracker_counts(turns: int, heading: float) -> None:
    manager = manager_of("3.0.0")
    manager.pose(STATE_LOCALIZED, (1.0, 2.0, heading + 2.0 * math.pi * turns))
    theta = manager.position["theta"]
    assert -math.pi <= theta <= math.pi
    assert [math.cos(theta), math.sin(theta)] == pytest.approx([math.cos(heading), math.sin(heading)])


def test_an_action_that_has_not_ended_stays_in_the_state_however_many_others_come(manager: Manager) -> None:
    manager.publish(set_position("p", major=manager.major))
    for number in range(40):
        manager.publish({"actionType": "stateRequest", "actionId": str(number), "blockingType": "NONE"})
    assert manager.action("p")["actionStatus"] == "RUNNING"
    assert len(manager.state["actionStates" if manager.major == 2 else "instantActionStates"]) == KEPT


def test_other_actions_and_orders_are_refused_and_requests_are_answered(manager: Manager) -> None:
    manager.pose()
    manager.publish({"actionType": "pick", "actionId": "p", "blockingType": "NONE"})
    assert manager.action("p")["actionStatus"] == "FAILED"
    assert ("INVALID_INSTANT_ACTION", "WARNING") in manager.errors
    sheets, states = len(manager.topics["factsheet"]), len(manager.topics["state"])
    manager.publish(
        {"actionType": "factsheetRequest", "actionId": "f", "blockingType": "NONE"},
        {"actionType": "stateRequest", "actionId": "s", "blockingType": "NONE"},
    )
    assert len(manager.topics["factsheet"]) == sheets + 1
    assert len(manager.topics["state"]) == states + 1
    assert {manager.action(name)["actionStatus"] for name in "fs"} == {"FINISHED"}
    manager.publish(topic="order", orderId="o1")
    assert manager.errors == [("MOBILE_ROBOT_NOT_AVAILABLE", "WARNING")]
    assert manager.words == []


def test_after_a_broker_was_gone_factsheet_and_state_come_again(manager: Manager) -> None:
    manager.pose()
    manager.receive("broker", b"connection lost")
    assert "connection lost" in manager.core.condition().detail
    counts = {topic: len(output) for topic, output in manager.topics.items()}
    manager.pose(STATE_LOST)
    manager.wait(3)
    assert counts == {topic: len(output) for topic, output in manager.topics.items()}
    manager.receive("broker", b"")
    assert len(manager.topics["factsheet"]) == counts["factsheet"] + 1
    assert len(manager.topics["state"]) == counts["state"] + 1
    assert not manager.is_localized
    numbers = [one["headerId"] for one in manager.topics["state"]]
    assert numbers == list(range(len(numbers)))


def test_an_action_that_ends_while_the_broker_is_gone_is_not_lost(manager: Manager) -> None:
    manager.pose(pose=(9.0, 9.0, 0.0))
    manager.publish(set_position(major=manager.major))
    manager.receive("broker", b"connection lost")
    manager.pose(STATE_AMBIGUOUS)
    manager.pose()
    manager.receive("broker", b"")
    assert manager.action("a1")["actionStatus"] == "FINISHED"
    assert manager.is_localized


def test_a_pose_that_is_none_is_counted_and_never_published(manager: Manager) -> None:
    for wrong in (math.nan, math.inf):
        manager.pose(pose=(wrong, 0.0, 0.0))  # each message is JSON: NaN and Infinity are not
    assert manager.core.condition().counters["set_aside_pose_not_finite"] == 2
    manager.pose()
    assert manager.is_localized


def test_the_settings_name_robot_map_and_sizes() -> None:
    sizes = {"speedMax": 1.5, "width": 0.6}
    manager = manager_of(
        "2.1.0", map_id="hall", serial_number="AGV-7", factsheet={"physicalParameters": sizes}
    )
    manager.pose()
    assert manager.position["mapId"] == "hall"
    assert manager.state["serialNumber"] == "AGV-7"
    assert manager.topics["factsheet"][0]["physicalParameters"].items() > sizes.items()


def test_beside_another_client_only_the_position_is_published() -> None:
    manager = manager_of("3.0.0", only_visualization=True)
    manager.pose()
    manager.wait(2)
    manager.publish(set_position())
    assert set(manager.topics) == {"visualization"}
    assert manager.words == []


def test_a_robot_that_moves_is_driving(manager: Manager) -> None:
    for step in range(12):
        manager.pose(pose=(0.05 * step, 0.0, 0.0))
    assert manager.state["driving"]
    for _ in range(12):
        manager.pose(pose=(0.55, 0.0, 0.0))
    assert not manager.state["driving"]


def test_a_robot_without_poses_does_not_drive_on(manager: Manager) -> None:
    for step in range(12):
        manager.pose(pose=(0.05 * step, 0.0, 0.0))
    assert manager.state["driving"]
    manager.wait(2)
    assert not manager.state["driving"]


def test_the_schemas_here_refuse_what_is_wrong(manager: Manager) -> None:
    manager.pose()
    good = {"timestamp": "2026-11-22T12:00:00.000Z", **manager.state}
    check("state", good, manager.major)
    for change in ({"headerId": "1"}, {"driving": None}, {"errors": [{"errorType": "x"}]}, {"extra": 1}):
        with pytest.raises(jsonschema.ValidationError):
            check("state", good | change, manager.major)
    with pytest.raises(jsonschema.ValidationError):
        check("state", {**good, "errors": [{"errorType": "x", "errorLevel": "SEVERE"}]}, manager.major)


def test_no_long_text_comes_back_in_each_state(manager: Manager) -> None:
    """Ids of 200 kB stayed in 32 actions: 6 MB in each state."""
    long = "x" * 200_000
    major = manager.major
    for number in range(32):
        manager.publish(set_position(f"{number}{long}", major=major))
        manager.publish(set_position(f"a{number}", major=major) | {"actionType": long})
        manager.publish(set_position(f"b{number}", major=major, lastNodeId=long))
        manager.publish(topic="order", orderId=long)
        manager.publish(headerId=long)
        manager.publish(version=long)
        manager.publish(set_position(f"c{number}", map_id=long, major=major))
        manager.publish(set_position(f"d{number}", major=major, x=long))
    assert max(len(json.dumps(state)) for state in manager.topics["state"]) < 10_000
    assert not manager.words
