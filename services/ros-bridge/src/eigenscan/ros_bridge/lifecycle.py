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

    def answer(self, kind: str, request: bytes) -> bytes:
        """Response to a request of a service's type."""
        response = f"{kind}_Response"
        if kind == CHANGE_STATE:
            wanted = cdr.decode(f"{kind}_Request", request).transition
            return cdr.encode(cdr.make(response, self._change(int(wanted.id), str(wanted.label))))
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

    def _change(self, number: int, label: str) -> bool:
        if number == 0:  # by name
            number = next((each for each, (name, _) in TRANSITIONS.items() if name == label), 0)
        if number not in TRANSITIONS:
            return False
        self._state = TRANSITIONS[number][1]
        return True

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
