"""The types of ROS 2's services: a request and a response each, and the hash of both."""

from __future__ import annotations

from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

EMPTY_SERVICE = "std_srvs/srv/Empty"
SET_INITIAL_POSE = "nav2_msgs/srv/SetInitialPose"
GET_STATE = "lifecycle_msgs/srv/GetState"
CHANGE_STATE = "lifecycle_msgs/srv/ChangeState"
AVAILABLE_STATES = "lifecycle_msgs/srv/GetAvailableStates"
AVAILABLE_TRANSITIONS = "lifecycle_msgs/srv/GetAvailableTransitions"
LIST_PARAMETERS = "rcl_interfaces/srv/ListParameters"
GET_PARAMETERS = "rcl_interfaces/srv/GetParameters"
GET_PARAMETER_TYPES = "rcl_interfaces/srv/GetParameterTypes"
DESCRIBE_PARAMETERS = "rcl_interfaces/srv/DescribeParameters"
SET_PARAMETERS = "rcl_interfaces/srv/SetParameters"

SERVICES = {
    EMPTY_SERVICE: ("", ""),
    SET_INITIAL_POSE: ("geometry_msgs/PoseWithCovarianceStamped pose", ""),
    GET_STATE: ("", "lifecycle_msgs/State current_state"),
    CHANGE_STATE: ("lifecycle_msgs/Transition transition", "bool success"),
    AVAILABLE_STATES: ("", "lifecycle_msgs/State[] available_states"),
    AVAILABLE_TRANSITIONS: ("", "lifecycle_msgs/TransitionDescription[] available_transitions"),
    LIST_PARAMETERS: ("string[] prefixes\nuint64 depth", "rcl_interfaces/ListParametersResult result"),
    GET_PARAMETERS: ("string[] names", "rcl_interfaces/ParameterValue[] values"),
    GET_PARAMETER_TYPES: ("string[] names", "uint8[] types"),
    DESCRIBE_PARAMETERS: ("string[] names", "rcl_interfaces/ParameterDescriptor[] descriptors"),
    SET_PARAMETERS: ("rcl_interfaces/Parameter[] parameters", "rcl_interfaces/SetParametersResult[] results"),
}
"""Fields of request and response."""

NO_FIELDS = "uint8 structure_needs_at_least_one_member"
"""IDL has no empty structures."""
_EVENT = "service_msgs/msg/ServiceEventInfo"


def request_and_response(kind: str) -> dict[str, Any]:
    """Types of both messages, `<kind>_Request` and `<kind>_Response`, for a store of types."""
    return {
        f"{kind}_{part}": get_types_from_msg(text or NO_FIELDS, "a/msg/B")["a/msg/B"]
        for part, text in zip(("Request", "Response"), SERVICES[kind], strict=True)
    }


def service_hash(kind: str) -> str:
    """REP 2011's hash: a service is hashed as a message of its request, its response and an event."""

    def named(name: str) -> Any:
        return (Nodetype.NAME, name)

    def at_most_one(name: str) -> Any:
        return (Nodetype.SEQUENCE, (named(name), 1))

    byte = (Nodetype.BASE, ("uint8", 0))
    request, response, event = f"{kind}_Request", f"{kind}_Response", f"{kind}_Event"
    types: dict[str, Any] = {
        _EVENT: [
            ("event_type", byte),
            ("stamp", named("builtin_interfaces/msg/Time")),
            # the library has it as char, which in ROS 2 is another name of uint8
            ("client_gid", (Nodetype.ARRAY, (byte, 16))),
            ("sequence_number", (Nodetype.BASE, ("int64", 0))),
        ],
        event: [
            ("info", named(_EVENT)),
            ("request", at_most_one(request)),
            ("response", at_most_one(response)),
        ],
        kind: [
            ("request_message", named(request)),
            ("response_message", named(response)),
            ("event_message", named(event)),
        ],
    }
    store = get_typestore(Stores.ROS2_HUMBLE)  # a later one refuses another _EVENT
    store.register(request_and_response(kind))
    store.register({name: ([], fields) for name, fields in types.items()})
    return str(store.hash_rihs01(kind))
