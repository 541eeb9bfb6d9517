"""What `ros2 param` asks of the bridge's two nodes."""

from pathlib import Path
from typing import Any

import pytest
from eigenscan.ros_bridge import cdr, parameters
from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.service_types import (
    DESCRIBE_PARAMETERS,
    GET_PARAMETER_TYPES,
    GET_PARAMETERS,
    LIST_PARAMETERS,
    SET_PARAMETERS,
)

from tests.services.ros_bridge.test_core import ask, core

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
    assert set(names) == {*parameters.AMCL_NAMES, "scan_topic"}
    base, odom, scan, ahead = get(
        bridge, AMCL, "base_frame_id", "odom_frame_id", "scan_topic", "transform_tolerance"
    )
    assert (base.string_value, odom.string_value, scan.string_value) == (
        "base_footprint",
        "wheels",
        "front/scan",
    )
    assert ahead.double_value == 0.1


def test_they_are_described_and_not_to_be_set() -> None:
    bridge = core()
    told, unknown = call(bridge, AMCL, DESCRIBE_PARAMETERS, ["tf_broadcast", "none_such"]).descriptors
    assert (told.name, told.type, told.read_only) == ("tf_broadcast", parameters.BOOL, True)
    assert told.description == RosBridgeOptions.model_fields["tf_broadcast"].description
    assert (unknown.name, unknown.type) == ("none_such", parameters.NOT_SET)
    (value,) = get(bridge, AMCL, "tf_broadcast")
    value.bool_value = False
    wanted = cdr.make("rcl_interfaces/msg/Parameter", "tf_broadcast", value)
    (result,) = call(bridge, AMCL, SET_PARAMETERS, [wanted]).results
    assert not result.successful
    assert "read-only" in result.reason
    assert get(bridge, AMCL, "tf_broadcast")[0].bool_value


def test_under_a_namespace_and_without_a_lifecycle_node() -> None:
    bridge = core(namespace="r17", lifecycle="")
    assert "odom" in call(bridge, "%r17%eigenscan", LIST_PARAMETERS, [], 0).result.names
    with pytest.raises(KeyError):
        call(bridge, "%r17%amcl", LIST_PARAMETERS, [], 0)
