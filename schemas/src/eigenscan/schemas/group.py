"""Groups of robots: names and patterns, joined by commas, such as `a-*,b-7`; `*` is every robot.

A `*` within a name stands for any characters, or none. A service of a group serves each matching robot from
its first message, without a restart.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache

from eigenscan.schemas.channels import Channel, ContractError, is_chunk

EVERY = "*"
MOST_PATTERNS = 200
"""Most patterns of a group, because every program of the site compares them with each robot's name."""


@lru_cache(maxsize=64)
def patterns(group: str) -> tuple[str, ...]:
    """The names and patterns of a group. Raises ContractError for an invalid name."""
    parts = group.split(",", MOST_PATTERNS)
    if len(parts) > MOST_PATTERNS:
        raise ContractError(f"a group of more than {MOST_PATTERNS} names: use patterns, such as a-*")
    found = tuple(re.sub(r"\*+", "*", part.strip()) for part in parts)
    for part in found:
        if not is_chunk(part.replace("*", "x")):
            raise ContractError(
                f"{part!r} is no robot: a name is not empty and has no blanks and none of / $ # ? @; "
                "* stands for any characters, commas join several, such as a-*,b-7"
            )
    return found


def is_one(group: str) -> bool:
    """Whether the group is one robot by its name."""
    found = patterns(group)
    return len(found) == 1 and "*" not in found[0]


def holds(group: str, robot: str) -> bool:
    """Whether a robot belongs to a group."""
    return any(_fits(part, robot) for part in patterns(group))


def _fits(pattern: str, robot: str) -> bool:
    """Matches each piece at its first place; a regular expression would try all places for all pieces."""
    first, *rest = pattern.split("*")
    if not rest:
        return robot == pattern
    *between, last = rest
    at = len(first)
    if not robot.startswith(first):
        return False
    for piece in between:
        found = robot.find(piece, at)
        if found < 0:
            return False
        at = found + len(piece)
    return len(robot) - at >= len(last) and robot.endswith(last)


def chunk_of(pattern: str) -> str:
    """The pattern as a chunk of a key expression: within a chunk Zenoh writes $* for any characters."""
    return pattern if pattern == EVERY else pattern.replace("*", "$*")


def selectors(channel: Channel, address: Mapping[str, str]) -> tuple[str, ...]:
    """Key expressions for all keys of a channel that fit `address`, whose robot may be a group."""
    if "robot" not in channel.fields or address.get("robot", EVERY) == EVERY:
        return (channel.selector({**address, "robot": EVERY}),)
    given = {name: address.get(name, "*") for name in channel.fields}
    return tuple(
        channel.selector({**given, "robot": part})
        if part == EVERY or is_chunk(part)
        else channel.selector({**given, "robot": EVERY}).replace("/robot/*", f"/robot/{chunk_of(part)}", 1)
        for part in patterns(address["robot"])
    )


def instance_name(group: str) -> str:
    """Default name of an instance that serves a group: the robot's name; 0 for every robot.

    A pattern's * becomes a +, which a key may contain.
    """
    return "0" if group == EVERY else ",".join(patterns(group)).replace("*", "+")
