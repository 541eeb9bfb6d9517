"""What `ros2 param` asks of the bridge's two nodes."""

from pathlib import Path
from typing import Any

import pytest
from eigenscan.ros_bridge import cdr, parameters
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.service_types import (
    CHANGE_STATE,
    DESCRIBE_PARAMETERS,
    GET_PARAMETER_TYPES,
    GET_PARAMETERS,
    LIST_PARAMETERS,
    SET_PARAMETERS,
)
from eigenscan.schemas.channels import HEALTH, POSE, RELOCATION, TRANSFORM
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.tracking_pb2 import PoseEstimate, Relocation
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

from tests.services.ros_bridge.test_core import ask, core, report

BRIDGE, AMCL = "%eigenscan", "%amcl"


def call(bridge: RosBridgeCore, node: str, kind: str, *fields: Any) -> Any:
    name = {
        LIST_PARAMETERS: "list_parameters",
        GET_PARAMETERS: "get_parameters",
        GET_PARAMETER_TYPES: "get_parameter_types",
        DESCRIBE_PARAMETERS: "describe_parameters",
        SET_PARAMETERS: "set_parameters",
    }[kind]
    request = cdr.encode(cdr.make(f"{kind}_Request", *fields))
    response, because = ask(bridge, f"{node}%{name}", request)
    assert because == []
    return cdr.decode(f"{kind}_Response", response)


def get(bridge: RosBridgeCore, node: str, *names: str) -> list[Any]:
    return list(call(bridge, node, GET_PARAMETERS, [*names]).values)


def test_all_settings_are_listed() -> None:
    listed = call(core(), BRIDGE, LIST_PARAMETERS, [], 0).result
    assert listed.names == sorted(RosBridgeOptions.model_fields)
    assert listed.prefixes == []
    assert call(core(), BRIDGE, LIST_PARAMETERS, ["odom", "none_such"], 1).result.names == ["odom"]


@pytest.mark.parametrize("kind", [GET_PARAMETERS, DESCRIBE_PARAMETERS, GET_PARAMETER_TYPES])
def test_a_request_of_very_many_parameters_is_refused(kind: str) -> None:
    """1.2 MB kept the bridge for half a second, and made 12 MB."""
    bridge = core()
    name = {GET_PARAMETERS: "get_parameters", DESCRIBE_PARAMETERS: "describe_parameters"}
    request = cdr.encode(cdr.make(f"{kind}_Request", ["scan"] * 1001))
    assert ask(bridge, f"{BRIDGE}%{name.get(kind, 'get_parameter_types')}", request) == (b"", [])
    assert bridge.condition().counters["set_aside_not_cdr"] == 1


def test_each_value_comes_in_its_own_type() -> None:
    bridge = core(scan=["front/scan", "rear/scan"], domain=7, ros_zenoh=Path("robot.json5"))
    names = ("tf_broadcast", "domain", "transform_tolerance", "odom", "ros_zenoh", "scan", "base_frame", "no")
    flag, whole, real, text, path, texts, unset, unknown = get(bridge, BRIDGE, *names)
    assert (flag.type, flag.bool_value) == (parameters.BOOL, True)
    assert (whole.type, whole.integer_value) == (parameters.INTEGER, 7)
    assert (real.type, real.double_value) == (parameters.DOUBLE, 0.1)
    assert (text.type, text.string_value) == (parameters.STRING, "odom")
    assert (path.type, path.string_value) == (parameters.STRING, "robot.json5")
    assert (texts.type, texts.string_array_value) == (parameters.STRINGS, ["front/scan", "rear/scan"])
    assert unset.type == unknown.type == parameters.NOT_SET
    types = call(bridge, BRIDGE, GET_PARAMETER_TYPES, [*names]).types
    assert types.tolist() == [each.type for each in get(bridge, BRIDGE, *names)]


def test_amcls_names_lead_to_what_they_are_here() -> None:
    bridge = core(base_frame="base_footprint", odom_frame="wheels", scan=["front/scan", "rear/scan"])
    names = call(bridge, AMCL, LIST_PARAMETERS, [], 0).result.names
    assert names == sorted(parameters.AMCL_NAMES)
    below = call(bridge, AMCL, LIST_PARAMETERS, ["initial_pose"], 0).result
    assert below.names == ["initial_pose.x", "initial_pose.y", "initial_pose.yaw"]
    assert below.prefixes == ["initial_pose"]
    base, odom, scan, ahead = get(
        bridge, AMCL, "base_frame_id", "odom_frame_id", "scan_topic", "transform_tolerance"
    )
    assert (base.string_value, odom.string_value, scan.string_value) == (
        "base_footprint",
        "wheels",
        "front/scan",
    )
    assert ahead.double_value == 0.1


def put(bridge: RosBridgeCore, node: str, name: str, kind: int, given: Any) -> str:
    """Why a parameter was not set; empty: it was."""
    (value,) = get(bridge, node, "no such parameter")
    value.type = kind
    setattr(value, parameters.FIELDS[kind], given)
    wanted = cdr.make("rcl_interfaces/msg/Parameter", name, value)
    (result,) = call(bridge, node, SET_PARAMETERS, [wanted]).results
    assert result.successful == (not result.reason)
    return str(result.reason)


def test_they_are_described_and_most_are_not_to_be_set() -> None:
    bridge = core()
    live, fixed, unknown = call(
        bridge, AMCL, DESCRIBE_PARAMETERS, ["tf_broadcast", "odom_frame_id", "none_such"]
    ).descriptors
    assert (live.name, live.type, live.read_only) == ("tf_broadcast", parameters.BOOL, False)
    assert live.description == RosBridgeOptions.model_fields["tf_broadcast"].description
    assert (fixed.name, fixed.read_only) == ("odom_frame_id", True)
    assert (unknown.name, unknown.type) == ("none_such", parameters.NOT_SET)
    assert "read-only" in put(bridge, AMCL, "odom_frame_id", parameters.STRING, "wheels")
    assert get(bridge, AMCL, "odom_frame_id")[0].string_value == "odom"


def transform_ahead(bridge: RosBridgeCore) -> list[float]:
    """By how much the transforms are dated ahead, s, that follow from one of the tracker's."""
    output = report(bridge, TRANSFORM, FrameTransform(timestamp=stamp(10**18)))
    stamps = [cdr.decode(cdr.TRANSFORMS, data).transforms[0].header.stamp for _, data in output]
    return [each.sec - 10**9 + each.nanosec * 1e-9 for each in stamps]


def test_what_nav2_tunes_while_it_runs_is_taken_at_once() -> None:
    bridge = core()
    assert transform_ahead(bridge) == [pytest.approx(0.1)]
    assert put(bridge, AMCL, "transform_tolerance", parameters.DOUBLE, 0.5) == ""
    assert transform_ahead(bridge) == [pytest.approx(0.5)]
    assert get(bridge, BRIDGE, "transform_tolerance")[0].double_value == 0.5  # one setting under two names
    assert put(bridge, AMCL, "tf_broadcast", parameters.BOOL, False) == ""
    assert transform_ahead(bridge) == []
    assert put(bridge, BRIDGE, "tf_broadcast", parameters.BOOL, True) == ""
    assert transform_ahead(bridge) == [pytest.approx(0.5)]


def test_what_cannot_be_is_refused_with_the_reason() -> None:
    bridge = core()
    assert "less than or equal to 10" in put(bridge, AMCL, "transform_tolerance", parameters.DOUBLE, 60.0)
    assert put(bridge, AMCL, "transform_tolerance", parameters.INTEGER, 1) == "must be of type float"
    assert "finite" in put(bridge, AMCL, "initial_pose.x", parameters.DOUBLE, float("nan"))
    assert put(bridge, AMCL, "alpha1", parameters.DOUBLE, 0.2) == "no such parameter"
    assert transform_ahead(bridge) == [pytest.approx(0.1)]
    without = core(tf_broadcast=False)
    assert "read-only" in put(without, AMCL, "tf_broadcast", parameters.BOOL, True)


def started(bridge: RosBridgeCore, service: str = "tracker", instance: str = "r") -> list[Relocation]:
    """Relocations that follow from a service's health."""
    health = Envelope(
        HEALTH, {"site": "s", "service": service, "instance": instance},
        Health(timestamp=stamp(10**18), service=service, instance=instance),
    )  # fmt: skip
    return [
        each.open(Relocation) for each in Loopback([bridge]).receive(health) if each.channel is RELOCATION
    ]


def test_a_known_start_is_reported_once_the_tracker_is_there() -> None:
    bridge = core(start_known=True, start_x=1.0, start_y=-2.0, start_yaw=0.5)
    assert started(bridge, service="projector") == started(bridge, instance="another") == []
    (at,) = started(bridge)
    assert (at.pose.x, at.pose.y, at.pose.theta) == (1.0, -2.0, 0.5)
    assert not at.frame_id  # the site's map
    assert started(bridge) == []
    assert started(core(start_x=1.0)) == []  # as AMCL, which needs set_initial_pose too


def test_a_known_start_is_reported_to_a_tracker_of_many_robots() -> None:
    """Its health names the group; its first pose shows that it is there."""
    bridge = core(start_known=True, start_x=1.0)
    assert started(bridge, instance="0") == []
    pose = Envelope(POSE, {"site": "s", "robot": "r"}, PoseEstimate(timestamp=stamp(10**18)))
    sent = [each for _ in range(2) for each in Loopback([bridge]).receive(pose)]
    assert [each.open(Relocation).pose.x for each in sent if each.channel is RELOCATION] == [1.0]


def test_a_start_that_is_set_counts_from_the_next_activation() -> None:
    bridge = core()
    started(bridge)
    assert put(bridge, AMCL, "set_initial_pose", parameters.BOOL, True) == ""
    assert put(bridge, AMCL, "initial_pose.x", parameters.DOUBLE, 3.0) == ""

    def relocated(transition: int) -> list[float]:
        wanted = cdr.make("lifecycle_msgs/msg/Transition", transition, "")
        _, because = ask(
            bridge, "%amcl%change_state", cdr.encode(cdr.make(f"{CHANGE_STATE}_Request", wanted))
        )
        return [each.open(Relocation).pose.x for each in because if each.channel is RELOCATION]

    deactivate, activate = 4, 3
    assert [relocated(step) for step in (activate, deactivate, activate)] == [[], [], [3.0]]


def test_under_a_namespace_and_without_a_lifecycle_node() -> None:
    bridge = core(namespace="r17", lifecycle="")
    assert "odom" in call(bridge, "%r17%eigenscan", LIST_PARAMETERS, [], 0).result.names
    with pytest.raises(KeyError):
        call(bridge, "%r17%amcl", LIST_PARAMETERS, [], 0)
