"""Answers Nav2's lifecycle manager in AMCL's name.

It works from the start and without a manager. It grants a manager's requests in every state, so a restarted
manager finds it as it would find a restarted AMCL.
"""

from __future__ import annotations

from typing import Any

from eigenscan.ros_bridge import cdr
from eigenscan.ros_bridge.service_types import (
    AVAILABLE_STATES,
    AVAILABLE_TRANSITIONS,
    CHANGE_STATE,
    GET_STATE,
)

UNCONFIGURED, INACTIVE, ACTIVE, FINALIZED = range(1, 5)
LABELS = {UNCONFIGURED: "unconfigured", INACTIVE: "inactive", ACTIVE: "active", FINALIZED: "finalized"}
"""lifecycle_msgs/State."""
TRANSITIONS = {
    1: ("configure", INACTIVE),
    2: ("cleanup", UNCONFIGURED),
    3: ("activate", ACTIVE),
    4: ("deactivate", INACTIVE),
    5: ("shutdown", FINALIZED),
    6: ("shutdown", FINALIZED),
    7: ("shutdown", FINALIZED),
}
"""lifecycle_msgs/Transition: label and the state that it leads to."""
ON_THE_WAY = {
    1: (10, "configuring"),
    2: (11, "cleaningup"),
    3: (13, "activating"),
    4: (14, "deactivating"),
    5: (12, "shuttingdown"),
    6: (12, "shuttingdown"),
    7: (12, "shuttingdown"),
}
"""The state between, by transition."""
SUCCESS = {10: 10, 11: 20, 13: 30, 14: 40, 12: 50}
"""The transition that ends such a state, `transition_success`."""
INSTANCE = "eigenscan"
"""Name of this side of the bond; the manager's is a UUID."""


class Lifecycle:
    """The lifecycle node `name`. All bytes are CDR; its methods raise CdrError."""

    def __init__(self, name: str) -> None:
        self._name = name.rpartition("/")[2]
        self._state = ACTIVE

    @property
    def active(self) -> bool:
        """Whether it may publish the robot's pose."""
        return self._state == ACTIVE

    @property
    def state(self) -> str:
        """The state's label."""
        return LABELS[self._state]

    def change(self, request: bytes) -> tuple[bytes, list[bytes]]:
        """Response to a request of a transition, and the events of it, as ROS 2's lifecycle nodes have them.

        Events have no time: the bridge's core has no clock, and many nodes leave it 0.
        """
        wanted, before = cdr.decode(f"{CHANGE_STATE}_Request", request).transition, self._state
        number = self._change(int(wanted.id), str(wanted.label))
        response = cdr.encode(cdr.make(f"{CHANGE_STATE}_Response", number > 0))
        if not number:
            return response, []
        between, label = ON_THE_WAY[number]
        way = cdr.make("lifecycle_msgs/msg/State", between, label)
        begun = cdr.make("lifecycle_msgs/msg/Transition", number, TRANSITIONS[number][0])
        ended = cdr.make("lifecycle_msgs/msg/Transition", SUCCESS[between], "transition_success")
        steps = (begun, _state(before), way), (ended, way, _state(self._state))
        return response, [cdr.encode(cdr.make(cdr.TRANSITION_EVENT, 0, *step)) for step in steps]

    def answer(self, kind: str) -> bytes:
        """Response to a request of a service's type; all but `change` have no fields."""
        response = f"{kind}_Response"
        content = {
            GET_STATE: lambda: _state(self._state),
            AVAILABLE_STATES: lambda: [_state(number) for number in LABELS],
            AVAILABLE_TRANSITIONS: self._transitions,
        }[kind]()
        return cdr.encode(cdr.make(response, content))

    def beat(self, data: bytes) -> bytes | None:
        """This side's heartbeat to one of the manager's; None to those of other nodes, and to its own.

        So it beats as fast as the manager does, needs no clock, and ends with the process.
        """
        theirs = cdr.decode(cdr.BOND, data)
        if theirs.id != self._name or theirs.instance_id == INSTANCE:
            return None
        alive = bool(theirs.active) and self.active
        times = theirs.heartbeat_timeout, theirs.heartbeat_period
        return cdr.encode(cdr.make(cdr.BOND, theirs.header, self._name, INSTANCE, alive, *times))

    def _change(self, number: int, label: str) -> int:
        """The transition that was made; 0: none."""
        if number == 0:  # by name
            number = next((each for each, (name, _) in TRANSITIONS.items() if name == label), 0)
        if number not in TRANSITIONS:
            return 0
        self._state = TRANSITIONS[number][1]
        return number

    def _transitions(self) -> list[Any]:
        return [
            cdr.make(
                "lifecycle_msgs/msg/TransitionDescription",
                cdr.make("lifecycle_msgs/msg/Transition", number, label),
                _state(self._state),
                _state(goal),
            )
            for number, (label, goal) in TRANSITIONS.items()
        ]


def _state(number: int) -> Any:
    return cdr.make("lifecycle_msgs/msg/State", number, LABELS[number])
