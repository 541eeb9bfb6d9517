"""What a lifecycle manager of Nav2 asks of AMCL, in the order in which it asks it."""

from typing import Any

import pytest
from eigenscan.geometry.pose import to_message
from eigenscan.ros_bridge import cdr, lifecycle
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.service_types import CHANGE_STATE, GET_STATE, SERVICES
from eigenscan.schemas.channels import MAP, POSE, TRACKS, TRANSFORM
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate, Tracks
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Grid_pb2 import Grid

from tests.services.ros_bridge.test_core import ask, core, header, listen, report

CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE, SHUTDOWN = 1, 2, 3, 4, 5  # lifecycle_msgs/Transition
UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = 1, 2, 3, 4  # lifecycle_msgs/State


def change(bridge: RosBridgeCore, transition: int, label: str = "") -> bool:
    wanted = cdr.make("lifecycle_msgs/msg/Transition", transition, label)
    request = cdr.encode(cdr.make(f"{CHANGE_STATE}_Request", wanted))
    response, _ = ask(bridge, "%amcl%change_state", request)
    return bool(cdr.decode(f"{CHANGE_STATE}_Response", response).success)


def state(bridge: RosBridgeCore) -> tuple[int, str]:
    response, _ = ask(bridge, "%amcl%get_state")
    current = cdr.decode(f"{GET_STATE}_Response", response).current_state
    return current.id, current.label


def beat(active: bool, name: str = "amcl", instance: str = "3f2b-manager") -> bytes:
    return cdr.encode(cdr.make(cdr.BOND, header(""), name, instance, active, 4.0, 0.25))


def answered(bridge: RosBridgeCore, data: bytes) -> list[Any]:
    return [
        cdr.decode(cdr.BOND, each.open(cdr_value()).value)
        for each in listen(bridge, "%bond", data)
        if each.address["endpoint"] == "%bond"
    ]


def cdr_value() -> Any:
    from google.protobuf.wrappers_pb2 import BytesValue

    return BytesValue


def test_without_a_manager_it_works() -> None:
    assert state(core()) == (ACTIVE, "active")


def test_a_manager_brings_it_up() -> None:
    """`startup` of nav2_lifecycle_manager: it asks for the state after each change."""
    bridge = core()
    for transition, expected in ((CONFIGURE, INACTIVE), (ACTIVATE, ACTIVE)):
        assert change(bridge, transition)
        assert state(bridge)[0] == expected


def test_a_manager_takes_it_down_and_another_brings_it_up_again() -> None:
    bridge = core()
    down = ((DEACTIVATE, INACTIVE), (CLEANUP, UNCONFIGURED), (SHUTDOWN, FINALIZED))
    for transition, expected in (*down, (CONFIGURE, INACTIVE), (ACTIVATE, ACTIVE)):
        assert change(bridge, transition)
        assert state(bridge)[0] == expected


def test_a_transition_by_its_name_and_one_that_is_none() -> None:
    bridge = core()
    assert change(bridge, 0, "deactivate")
    assert state(bridge)[0] == INACTIVE
    assert not change(bridge, 99)
    assert not change(bridge, 0, "fly")
    assert state(bridge)[0] == INACTIVE


def events(bridge: RosBridgeCore, transition: int) -> list[tuple[int, str, str, str]]:
    """Number and label of each transition event, and the states that it leads from and to."""
    wanted = cdr.make("lifecycle_msgs/msg/Transition", transition, "")
    _, because = ask(bridge, "%amcl%change_state", cdr.encode(cdr.make(f"{CHANGE_STATE}_Request", wanted)))
    assert {each.address["endpoint"] for each in because} <= {"%amcl%transition_event"}
    found = [cdr.decode(cdr.TRANSITION_EVENT, each.open(cdr_value()).value) for each in because]
    return [
        (each.transition.id, each.transition.label, each.start_state.label, each.goal_state.label)
        for each in found
    ]


def test_each_transition_has_the_events_of_a_lifecycle_node() -> None:
    """A callback between: one event when it begins, one when it succeeded (rcl_lifecycle)."""
    bridge = core()
    assert events(bridge, DEACTIVATE) == [
        (4, "deactivate", "active", "deactivating"),
        (40, "transition_success", "deactivating", "inactive"),
    ]
    assert events(bridge, CLEANUP) == [
        (2, "cleanup", "inactive", "cleaningup"),
        (20, "transition_success", "cleaningup", "unconfigured"),
    ]
    assert events(bridge, CONFIGURE)[1] == (10, "transition_success", "configuring", "inactive")
    assert events(bridge, ACTIVATE)[1] == (30, "transition_success", "activating", "active")
    assert events(bridge, SHUTDOWN)[1] == (50, "transition_success", "shuttingdown", "finalized")
    assert events(bridge, 99) == []


def test_while_it_is_not_active_it_reports_only_the_map() -> None:
    bridge = core()
    pose = PoseEstimate(timestamp=stamp(10**18), frame_id="map", pose=to_message((1, 2, 0)))
    pose.state = STATE_LOCALIZED
    grid = Grid(frame_id="map", column_count=1, row_stride=1, cell_stride=1, data=b"\0")
    grid.cell_size.x = grid.cell_size.y = 0.05
    grid.pose.orientation.w = 1.0
    messages = {POSE: pose, TRANSFORM: FrameTransform(), TRACKS: Tracks(), MAP: grid}
    change(bridge, DEACTIVATE)
    output = {channel for channel, message in messages.items() if report(bridge, channel, message)}
    assert output == {MAP}
    condition = bridge.condition()
    assert condition.status == Health.STATUS_WAITING
    assert "a lifecycle manager has it inactive" in condition.detail
    change(bridge, ACTIVATE)
    assert {name for name, message in messages.items() if report(bridge, name, message)} == {*messages}


def test_the_bond_beats_as_the_manager_does() -> None:
    bridge = core()
    (ours,) = answered(bridge, beat(active=True))
    assert (ours.id, ours.active) == ("amcl", True)
    assert ours.instance_id != "3f2b-manager"
    assert (ours.heartbeat_timeout, ours.heartbeat_period) == (4.0, 0.25)
    # its own, as a second bridge would publish it, and those of the other nodes
    assert answered(bridge, beat(active=True, instance=ours.instance_id)) == []
    assert answered(bridge, beat(active=True, name="controller_server")) == []


@pytest.mark.parametrize("active", [False, True])
def test_the_bond_breaks_when_either_side_ends_it(active: bool) -> None:
    bridge = core()
    if active:
        change(bridge, DEACTIVATE)
    (ours,) = answered(bridge, beat(active))
    assert not ours.active


def test_states_and_transitions_are_reported() -> None:
    bridge = core()
    kinds = {
        name: kind for kind in SERVICES for name in ("states", "transitions") if kind.endswith(name.title())
    }
    response, _ = ask(bridge, "%amcl%get_available_states")
    states = cdr.decode(f"{kinds['states']}_Response", response).available_states
    assert [each.label for each in states] == ["unconfigured", "inactive", "active", "finalized"]
    response, _ = ask(bridge, "%amcl%get_available_transitions")
    offered = cdr.decode(f"{kinds['transitions']}_Response", response).available_transitions
    assert {each.transition.id: each.goal_state.id for each in offered} == {
        number: goal for number, (_, goal) in lifecycle.TRANSITIONS.items()
    }


def test_a_node_of_another_name() -> None:
    bridge = core(lifecycle="localizer", namespace="r17")
    response, _ = ask(bridge, "%r17%localizer%get_state")
    assert cdr.decode(f"{GET_STATE}_Response", response).current_state.id == ACTIVE
    assert len(listen(bridge, "%r17%bond", beat(active=True, name="localizer"))) == 1
