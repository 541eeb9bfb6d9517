"""Answers ROS 2's parameter services with the bridge's settings, read-only.

`ros2 param list`, `get`, `describe` and `dump` use them. A parameter client waits until all five services
exist.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
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

NOT_SET, BOOL, INTEGER, DOUBLE, STRING, STRINGS = 0, 1, 2, 3, 4, 9
"""rcl_interfaces/ParameterType."""
READ_ONLY = "read-only: give it to ros-bridge as a setting, and start it again"
AMCL_NAMES = {
    "base_frame_id": "base_frame",
    "odom_frame_id": "odom_frame",
    "tf_broadcast": "tf_broadcast",
    "transform_tolerance": "transform_tolerance",
}
"""AMCL's parameters that mean something here, and the settings that they are."""

Value = bool | int | float | str | list[str] | None


@dataclass(frozen=True)
class _Parameter:
    value: Value
    about: str

    @property
    def kind(self) -> int:
        """rcl_interfaces/ParameterType."""
        kinds = {bool: BOOL, int: INTEGER, float: DOUBLE, str: STRING, list: STRINGS}
        return kinds.get(type(self.value), NOT_SET)


class Parameters:
    """The parameters of one node. All bytes are CDR; `answer` raises CdrError."""

    def __init__(self, parameters: dict[str, _Parameter]) -> None:
        self._parameters = parameters

    @classmethod
    def of_bridge(cls, settings: RosBridgeSettings) -> Parameters:
        """All settings, by their own names."""
        return cls({name: _parameter(settings, name) for name in type(settings).model_fields})

    @classmethod
    def of_amcl(cls, settings: RosBridgeSettings) -> Parameters:
        """The settings that AMCL has too, by AMCL's names."""
        parameters = {name: _parameter(settings, ours) for name, ours in AMCL_NAMES.items()}
        first_scan = _Parameter(settings.scan[0], _about(settings, "scan"))
        return cls(parameters | {"scan_topic": first_scan})

    def answer(self, kind: str, request: bytes) -> bytes:
        """Response to a request of a service's type."""
        asked = cdr.decode(f"{kind}_Request", request)
        answers: dict[str, Callable[[], Any]] = {
            LIST_PARAMETERS: lambda: self._list(asked.prefixes),
            GET_PARAMETERS: lambda: [_value(self._parameters.get(name)) for name in asked.names],
            GET_PARAMETER_TYPES: lambda: _bytes([self._kind(name) for name in asked.names]),
            DESCRIBE_PARAMETERS: lambda: [self._description(name) for name in asked.names],
            SET_PARAMETERS: lambda: [
                cdr.make("rcl_interfaces/msg/SetParametersResult", False, READ_ONLY) for _ in asked.parameters
            ],
        }
        return cdr.encode(cdr.make(f"{kind}_Response", answers[kind]()))

    def _list(self, prefixes: Sequence[str]) -> Any:
        """Names have no dots, so none lies under a prefix but the prefix itself."""
        names = [name for name in self._parameters if not prefixes or name in prefixes]
        return cdr.make("rcl_interfaces/msg/ListParametersResult", sorted(names), [])

    def _kind(self, name: str) -> int:
        found = self._parameters.get(name)
        return found.kind if found else NOT_SET

    def _description(self, name: str) -> Any:
        found = self._parameters.get(name)
        about = found.about if found else ""
        kind = self._kind(name)
        return cdr.make("rcl_interfaces/msg/ParameterDescriptor", name, kind, about, "", True, False, [], [])


def _parameter(settings: RosBridgeSettings, name: str) -> _Parameter:
    value = getattr(settings, name)
    return _Parameter(str(value) if isinstance(value, Path) else value, _about(settings, name))


def _about(settings: RosBridgeSettings, name: str) -> str:
    return type(settings).model_fields[name].description or ""


def _value(parameter: _Parameter | None) -> Any:
    kind = parameter.kind if parameter else NOT_SET
    value = parameter.value if parameter else None

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
