"""The floors of a site: separate parts of its one map, each with its own map frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from eigenscan.geometry.pose import FARTHEST_M, Array, between, from_message, to_message
from eigenscan.schemas.model_pb2 import ModelSet
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Floor:
    """`origin` (3,): pose of the floor's own map frame in the site's. `outline` (4, 2) m, site's frame.

    The outline's corners are those of the floor's own map, in turn.
    """

    name: str
    origin: Array
    outline: Array

    def holds(self, pose: ArrayLike) -> bool:
        """Whether a pose (3,) in the site's frame is on this floor."""
        corner, along, _, across = self.outline
        sides = np.array([along - corner, across - corner])
        share = sides @ (np.asarray(pose, dtype=np.float64)[:2] - corner) / np.sum(sides**2, axis=1)
        return bool(np.all((share >= 0.0) & (share <= 1.0)))

    def own(self, pose: ArrayLike) -> Array:
        """A pose (..., 3) of the site's frame in the floor's own."""
        return between(self.origin, pose)

    def to_message(self) -> ModelSet.Floor:
        """The message of the same name."""
        x, y = self.outline.T.tolist()
        return ModelSet.Floor(name=self.name, origin=to_message(self.origin), outline_x=x, outline_y=y)

    @classmethod
    def from_message(cls, message: ModelSet.Floor) -> Floor:
        """Inverse of to_message."""
        outline = np.column_stack([message.outline_x, message.outline_y])
        return cls(message.name, from_message(message.origin), outline)

    def to_json(self) -> dict[str, Any]:
        """Its entry in the manifest."""
        return {"name": self.name, "origin": self.origin.tolist(), "outline": self.outline.tolist()}

    @classmethod
    def from_json(cls, published: dict[str, Any]) -> Floor:
        """Inverse of to_json. Raises KeyError, TypeError or ValueError for other content."""
        return cls(
            str(published["name"]),
            np.array(published["origin"], dtype=np.float64).reshape(3),
            np.array(published["outline"], dtype=np.float64).reshape(4, 2),
        )


def floor_of(floors: Iterable[Floor], pose: ArrayLike) -> Floor | None:
    """The floor of a pose (3,) in the site's frame; None if it is on none."""
    return next((floor for floor in floors if floor.holds(pose)), None)


def usable_floors(message: ModelSet) -> tuple[Floor, ...]:
    """The floors of a set, without invalid ones (no name, no outline, bad numbers)."""
    return tuple(Floor.from_message(published) for published in message.floors if _is_floor(published))


def _is_floor(published: ModelSet.Floor) -> bool:
    if not published.name or len(published.outline_x) != 4 or len(published.outline_y) != 4:
        return False
    numbers = [
        *published.outline_x,
        *published.outline_y,
        published.origin.x,
        published.origin.y,
        published.origin.theta,
    ]
    if not all(abs(number) <= FARTHEST_M for number in numbers):
        return False
    corner, along, _, across = np.column_stack([published.outline_x, published.outline_y])
    return float(np.hypot(*(along - corner))) > 0.0 and float(np.hypot(*(across - corner))) > 0.0
