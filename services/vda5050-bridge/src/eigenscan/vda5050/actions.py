"""Instant actions: read and checked, and followed until they have ended."""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import Array
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.vda5050.position import claims

SET_POSITION = ("initPosition", "initializePosition")
"""Its name in version 2 and in version 3; both are taken."""
STATE_REQUEST, FACTSHEET_REQUEST = "stateRequest", "factsheetRequest"
LONGEST = 256
"""Characters of an id or a name: the state repeats them."""
KEPT = 32
"""Finished actions that the state lists; the oldest are dropped first."""
NEAR_M, NEAR_RAD = 1.0, math.radians(30.0)
"""A pose that is claimed so near to the one that was set confirms it: clicks are as far off."""
SETTLED_TICKS = 2
"""s after which a claim is a new one, if none was withdrawn meanwhile."""


class MessageError(ValueError):
    """An invalid message from the broker; the text names the field."""


@dataclass
class Action:
    """One action and how far it is."""

    name: str
    kind: str
    status: str = "RUNNING"
    result: str = ""
    target: Array | None = None
    """(3,) in the site's frame, of one that sets the position."""
    ticks: int = 0
    withdrawn: bool = False
    """Whether the claim of before has ended."""

    @property
    def is_open(self) -> bool:
        """Whether it has not ended."""
        return self.status == "RUNNING"

    def end(self, status: str, result: str = "") -> None:
        """FINISHED or FAILED, and why."""
        self.status, self.result = status, result

    def state_fields(self, major: int) -> dict[str, str]:
        """ActionState of the standard."""
        state_fields = {"actionId": self.name, "actionType": self.kind, "actionStatus": self.status}
        if self.result:
            state_fields["resultDescription" if major == 2 else "actionResult"] = self.result
        return state_fields

    def receive(self, estimate: PoseEstimate, pose: Array) -> None:
        """Follows the tracker: the scans confirm the position that was set, or contradict it."""
        if self.target is None or not self.is_open:
            return
        if not claims(estimate):
            self.withdrawn = True
        elif self.withdrawn or self.ticks >= SETTLED_TICKS:
            off = pose - self.target
            if np.hypot(off[0], off[1]) <= NEAR_M and abs(float(wrap(off[2]))) <= NEAR_RAD:
                self.end("FINISHED")
            else:
                self.end("FAILED", f"scans contradict it: localized {np.hypot(off[0], off[1]):.1f} m away")


class Actions:
    """Those that were received, by id."""

    def __init__(self) -> None:
        self._all: OrderedDict[str, Action] = OrderedDict()

    def __contains__(self, name: str) -> bool:
        return name in self._all

    def add(self, action: Action) -> None:
        """Takes one; a position that is still being set by another one has failed."""
        if action.target is not None:
            for other in self.setting:
                other.end("FAILED", f"replaced by {action.name}")
        self._all[action.name] = action
        ended = [name for name, one in self._all.items() if not one.is_open]
        for name in ended[: max(len(self._all) - KEPT, 0)]:
            del self._all[name]

    @property
    def setting(self) -> list[Action]:
        """Those that set the position and have not ended."""
        return [one for one in self._all.values() if one.is_open and one.target is not None]

    def state_fields(self, major: int) -> list[dict[str, str]]:
        """All of them, oldest first."""
        return [one.state_fields(major) for one in self._all.values()]


def read_message(data: bytes, major: int, manufacturer: str, serial: str) -> dict[str, Any]:
    """The JSON object of a message for this robot. Raises MessageError that names the fault."""
    try:
        published = json.loads(data, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise MessageError(f"is no JSON: {error}") from None
    if not isinstance(published, dict):
        raise MessageError("is no JSON object")
    number = published.get("headerId")
    if isinstance(number, bool) or not isinstance(number, int):
        raise MessageError(f"headerId: {number!r:.60} is no integer")
    version = published.get("version")
    if not isinstance(version, str) or version.partition(".")[0] != str(major):
        raise MessageError(f"version: {version!r:.60} is not {major}.x")
    for field, expected in (("manufacturer", manufacturer), ("serialNumber", serial)):
        if published.get(field) != expected:
            raise MessageError(f"{field}: {published.get(field)!r:.60} is not {expected!r}")
    return published


def actions_of(published: dict[str, Any]) -> list[dict[str, Any]]:
    """Actions of a message that have type and id. Raises MessageError."""
    listed = published.get("actions", published.get("instantActions"))
    if not isinstance(listed, list):
        raise MessageError("actions: is no array")
    if len(listed) > KEPT:  # each may be answered by a whole message
        raise MessageError(f"actions: more than {KEPT}")
    for number, one in enumerate(listed):
        if not isinstance(one, dict):
            raise MessageError(f"actions[{number}]: is no object")
        for field in ("actionType", "actionId"):
            if not isinstance(one.get(field), str) or not one[field]:
                raise MessageError(f"actions[{number}].{field}: is no text")
            if len(one[field]) > LONGEST:
                raise MessageError(f"actions[{number}].{field}: is longer than {LONGEST} characters")
    return listed


def position_of(action: dict[str, Any]) -> tuple[str, Array, str]:
    """mapId, pose (3,) on that map, and lastNodeId. Raises MessageError naming the parameter."""
    given = action.get("actionParameters")
    pairs = given if isinstance(given, list) else []
    known = {
        pair["key"]: pair.get("value")
        for pair in pairs
        if isinstance(pair, dict) and isinstance(pair.get("key"), str)
    }
    pose = []
    for name in ("x", "y", "theta"):
        value = known.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e7:
            raise MessageError(f"{name}: {value!r:.60} is no number")
        pose.append(float(value))
    map_id, node = known.get("mapId"), known.get("lastNodeId", "")
    if not isinstance(map_id, str):
        raise MessageError(f"mapId: {map_id!r:.60} is no text")
    if len(str(node)) > LONGEST:
        raise MessageError(f"lastNodeId: is longer than {LONGEST} characters")
    return map_id, np.array([pose[0], pose[1], float(wrap(pose[2]))]), node if isinstance(node, str) else ""


def _no_number(name: str) -> float:
    raise ValueError(f"{name} is no number")
