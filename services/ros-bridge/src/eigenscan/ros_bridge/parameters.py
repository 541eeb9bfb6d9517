"""Answers ROS 2's parameter services with the bridge's settings; some may be set while it runs.

`ros2 param list`, `get`, `set`, `describe` and `dump` use them. A parameter client waits until all five
services exist.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.service_types import (
    DESCRIBE_PARAMETERS,
    GET_PARAMETER_TYPES,
    GET_PARAMETERS,
    LIST_PARAMETERS,
    SET_PARAMETERS,
)
from eigenscan.ros_bridge.settings import RosBridgeSettings
from pydantic import ValidationError

NOT_SET, BOOL, INTEGER, DOUBLE, STRING, STRINGS = 0, 1, 2, 3, 4, 9
"""rcl_interfaces/ParameterType."""
KINDS = {bool: BOOL, int: INTEGER, float: DOUBLE, str: STRING, list: STRINGS}
FIELDS = {BOOL: "bool_value", INTEGER: "integer_value", DOUBLE: "double_value", STRING: "string_value"}
"""Of rcl_interfaces/ParameterValue, by type."""
MOST_ASKED = 1000
"""Names in a request: the answer is up to ten times as long."""
READ_ONLY = "read-only: give it to ros-bridge as a setting, and start it again"
AMCL_NAMES = {
    "base_frame_id": "base_frame",
    "odom_frame_id": "odom_frame",
    "scan_topic": "scan",
    "tf_broadcast": "tf_broadcast",
    "transform_tolerance": "transform_tolerance",
    "set_initial_pose": "start_known",
    "initial_pose.x": "start_x",
    "initial_pose.y": "start_y",
    "initial_pose.yaw": "start_yaw",
}
"""AMCL's parameters that mean something here, and the settings that they are."""
LIVE = frozenset({"tf_broadcast", "transform_tolerance", "start_known", "start_x", "start_y", "start_yaw"})
"""Settings that a running bridge takes; all others decide which topics it has."""

Value = bool | int | float | str | list[str] | None


class LiveSettings:
    """The bridge's settings as they are now."""

    def __init__(self, settings: RosBridgeSettings) -> None:
        self.now = settings
        # without a publisher of map to odom, it cannot be switched on
        self._live = LIVE if settings.tf_broadcast else LIVE - {"tf_broadcast"}

    def is_live(self, name: str) -> bool:
        """Whether a setting may change."""
        return name in self._live

    def set(self, name: str, value: Value) -> str:
        """Changes a setting; returns why it cannot, or nothing."""
        if not self.is_live(name):
            return READ_ONLY
        wanted = type(getattr(self.now, name))
        if type(value) is not wanted:  # as in ROS, where a double is no integer
            return f"must be of type {wanted.__name__}"
        try:
            given = {each: getattr(self.now, each) for each in RosBridgeSettings.model_fields}
            RosBridgeSettings.model_validate(given | {name: value})
        except ValidationError as error:
            return str(error.errors()[0]["msg"])
        self.now = self.now.model_copy(update={name: value})
        return ""


class Parameters:
    """The parameters of one node. All bytes are CDR; `answer` raises CdrError."""

    def __init__(self, settings: LiveSettings, names: Mapping[str, str]) -> None:
        """`names`: the setting of each parameter."""
        self._settings, self._names = settings, names

    @classmethod
    def of_bridge(cls, settings: LiveSettings) -> Parameters:
        """All settings, by their own names."""
        return cls(settings, {name: name for name in type(settings.now).model_fields})

    @classmethod
    def of_amcl(cls, settings: LiveSettings) -> Parameters:
        """The settings that AMCL has too, by AMCL's names."""
        return cls(settings, AMCL_NAMES)

    def answer(self, kind: str, request: bytes) -> bytes:
        """Response to a request of a service's type."""
        asked = cdr.decode(f"{kind}_Request", request)
        for listed in vars(asked).values():
            if isinstance(listed, list) and len(listed) > MOST_ASKED:
                raise cdr.CdrError(f"{kind}: asks for {len(listed)} parameters, {MOST_ASKED} at most")
        answers: dict[str, Callable[[], Any]] = {
            LIST_PARAMETERS: lambda: self._list(asked.prefixes),
            GET_PARAMETERS: lambda: [_message(self._value(name)) for name in asked.names],
            GET_PARAMETER_TYPES: lambda: _bytes([_kind(self._value(name)) for name in asked.names]),
            DESCRIBE_PARAMETERS: lambda: [self._description(name) for name in asked.names],
            SET_PARAMETERS: lambda: [self._set(str(each.name), each.value) for each in asked.parameters],
        }
        return cdr.encode(cdr.make(f"{kind}_Response", answers[kind]()))

    def _list(self, prefixes: Sequence[str]) -> Any:
        """Names that are one of the prefixes or lie under it, and what they lie under."""
        names = [
            name
            for name in sorted(self._names)
            if not prefixes or any(name == one or name.startswith(f"{one}.") for one in prefixes)
        ]
        above = sorted({name.rpartition(".")[0] for name in names if "." in name})
        return cdr.make("rcl_interfaces/msg/ListParametersResult", names, above)

    def _value(self, name: str) -> Value:
        """A parameter's value; None if it is not set, or no parameter."""
        if name not in self._names:
            return None
        value = getattr(self._settings.now, self._names[name])
        if name == "scan_topic":
            return str(value[0])  # AMCL has one lidar
        return str(value) if isinstance(value, Path) else value

    def _set(self, name: str, value: Any) -> Any:
        field, setting = FIELDS.get(int(value.type)), self._names.get(name, "")
        given = getattr(value, field) if field else None
        reason = self._settings.set(setting, given) if setting else "no such parameter"
        return cdr.make("rcl_interfaces/msg/SetParametersResult", not reason, reason)

    def _description(self, name: str) -> Any:
        setting = self._names.get(name, "")
        field = type(self._settings.now).model_fields.get(setting)
        about = (field.description or "") if field else ""
        kind, fixed = _kind(self._value(name)), not self._settings.is_live(setting)
        return cdr.make("rcl_interfaces/msg/ParameterDescriptor", name, kind, about, "", fixed, False, [], [])


def _kind(value: Value) -> int:
    """rcl_interfaces/ParameterType."""
    return KINDS.get(type(value), NOT_SET)


def _message(value: Value) -> Any:
    kind = _kind(value)

    def where(wanted: int, otherwise: Any) -> Any:
        return value if kind == wanted else otherwise

    return cdr.make(
        "rcl_interfaces/msg/ParameterValue",
        kind,
        where(BOOL, False),
        where(INTEGER, 0),
        where(DOUBLE, 0.0),
        where(STRING, ""),
        _bytes([]),
        np.zeros(0, dtype=bool),
        np.zeros(0, dtype=np.int64),
        np.zeros(0),
        where(STRINGS, []),
    )


def _bytes(values: list[int]) -> Any:
    return np.array(values, dtype=np.uint8)
