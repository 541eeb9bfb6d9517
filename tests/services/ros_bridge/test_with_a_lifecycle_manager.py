"""The bridge in AMCL's place under a lifecycle manager, over a real Zenoh router.

The manager's requests and heartbeats are those of nav2_lifecycle_manager, published by an independent program
(see conftest): it finds the services by their types' hashes.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from eigenscan.geometry.pose import to_message
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.outbound import pose_with_covariance
from eigenscan.ros_bridge.service_types import (
    CHANGE_STATE,
    EMPTY_SERVICE,
    GET_PARAMETERS,
    GET_STATE,
    LIST_PARAMETERS,
    SET_INITIAL_POSE,
    SET_PARAMETERS,
)
from eigenscan.schemas.channels import RELOCATION
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation
from zenoh_ros2_sdk import ROS2ServiceClient, get_service_info

from tests.services.ros_bridge.conftest import Bridge, Robot, eventually, fields

pytestmark = pytest.mark.slow

Start = Callable[..., Bridge]
Call = Callable[..., Any]
CONFIGURE, ACTIVATE, DEACTIVATE = 1, 3, 4  # lifecycle_msgs/Transition
INACTIVE, ACTIVE = 2, 3  # lifecycle_msgs/State


@pytest.fixture
def call(robot: Robot) -> Iterator[Call]:
    """Calls a service by its name, until it answers."""
    clients: dict[str, ROS2ServiceClient] = {}

    def call(name: str, kind: str, **request: Any) -> Any:
        if name not in clients:
            about = {"domain_id": robot.domain, "router_port": robot.port, "timeout": 60.0}
            clients[name] = ROS2ServiceClient(name, kind, **about)
        given = request or {"structure_needs_at_least_one_member": 0}
        return eventually(lambda: clients[name].call(**given), f"the response of {name}")

    yield call
    for client in clients.values():
        client.close()


def test_a_manager_brings_it_up_and_keeps_a_bond_with_it(start: Start, robot: Robot, call: Call) -> None:
    bridge = start("--domain", str(robot.domain))

    def change(transition: int) -> int:
        wanted = cdr.make("lifecycle_msgs/msg/Transition", transition, "")
        assert call("/amcl/change_state", CHANGE_STATE, transition=wanted).success
        return int(call("/amcl/get_state", GET_STATE).current_state.id)

    events = robot.subscribe("/amcl/transition_event", cdr.TRANSITION_EVENT)

    def reconfigured() -> bool:
        change(CONFIGURE)
        return len(events) > 0

    eventually(reconfigured, "a transition event")
    assert [events[0].transition.label, events[0].goal_state.label] == ["configure", "configuring"]
    assert change(ACTIVATE) == ACTIVE
    received = robot.subscribe("/bond", cdr.BOND)
    bond = robot.publisher("/bond", cdr.BOND)

    def beat(active: bool) -> list[Any]:
        message = cdr.make(cdr.BOND, _header(), "amcl", "the-manager", active, 4.0, 0.25)
        bond.publish(**fields(message))
        time.sleep(0.1)
        return [each for each in received if each.instance_id != "the-manager"]

    assert eventually(lambda: beat(active=True), "a heartbeat")[0].active
    assert change(DEACTIVATE) == INACTIVE
    assert eventually(lambda: [each for each in beat(active=False) if not each.active], "the bond's end")
    bridge.process.terminate()
    bridge.process.wait()
    received.clear()
    # nobody beats any more: the manager takes the robot's navigation down
    assert not any(beat(active=True) for _ in range(5))


def _header() -> Any:
    return cdr.make("std_msgs/msg/Header", cdr.make("builtin_interfaces/msg/Time", 0, 0), "")


def test_it_is_there_before_any_manager_under_amcls_name(start: Start, robot: Robot, call: Call) -> None:
    """As nav2_simple_commander waits for it, and `ros2 lifecycle` finds it."""
    start("--domain", str(robot.domain))
    assert call("/amcl/get_state", GET_STATE).current_state.label == "active"

    def served_by() -> list[str]:
        asked = {"domain_id": robot.domain, "router_port": robot.port, "verbose": True}
        info = get_service_info("/amcl/get_state", **asked)
        return [server.node_name for server in info.servers] if info else []

    assert eventually(served_by, "the server") == ["amcl"]


def test_amcls_other_services(start: Start, robot: Robot, call: Call) -> None:
    bridge = start("--domain", str(robot.domain))
    call("/request_nomotion_update", EMPTY_SERVICE)
    estimate = PoseEstimate(timestamp=stamp(10**18), frame_id="map", pose=to_message((4.0, 5.0, 1.0)))
    pose = cdr.decode(cdr.POSE_WITH_COVARIANCE, pose_with_covariance(estimate))
    call("/set_initial_pose", SET_INITIAL_POSE, pose=pose)
    reported = eventually(lambda: bridge.ear.of(RELOCATION, Relocation), "the pose")
    assert (reported[0].pose.x, reported[0].pose.y) == (4.0, 5.0)


def test_ros2_param_is_answered(start: Start, robot: Robot, call: Call) -> None:
    start("--domain", str(robot.domain), "--odom-frame", "wheels")
    listed = call("/amcl/list_parameters", LIST_PARAMETERS, prefixes=[], depth=0).result
    assert "odom_frame_id" in listed.names
    reported = call("/eigenscan/get_parameters", GET_PARAMETERS, names=["odom_frame"]).values
    assert [each.string_value for each in reported] == ["wheels"]
    (value,) = call("/amcl/get_parameters", GET_PARAMETERS, names=["transform_tolerance"]).values
    value.double_value = 0.5
    wanted = cdr.make("rcl_interfaces/msg/Parameter", "transform_tolerance", value)
    assert call("/amcl/set_parameters", SET_PARAMETERS, parameters=[wanted]).results[0].successful
    (value,) = call("/amcl/get_parameters", GET_PARAMETERS, names=["transform_tolerance"]).values
    assert value.double_value == 0.5
