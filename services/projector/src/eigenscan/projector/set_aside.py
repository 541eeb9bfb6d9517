"""How much a projector holds of what nobody needs yet: who publishes models must not fill its memory."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

from eigenscan.eigenspace.analysis import RegionSpace
from eigenscan.eigenspace.model import RegionModel

MOST, MOST_BYTES = 4096, 2**30
"""Of models and of spaces, each."""

MOST_REGIONS, MOST_SET_BYTES = 16_384, 2**32
"""Regions of an announced set, and memory of it and of the one in use: over a square kilometre of rooms."""

Key = TypeVar("Key", bound=Hashable)


class Sizes(Generic[Key]):
    """Sizes of what is held, in bytes, the oldest first, and their running sum."""

    def __init__(self) -> None:
        self._sizes: OrderedDict[Key, int] = OrderedDict()
        self._total = 0

    def put(self, key: Key, size: int) -> list[Key]:
        """Adds one; takes and returns the oldest that are too many. The newest one stays."""
        self.take(key)
        self._sizes[key] = size
        self._total += size
        found = []
        while len(self._sizes) > 1 and (len(self._sizes) > MOST or self._total > MOST_BYTES):
            found.append(next(iter(self._sizes)))
            self.take(found[-1])
        return found

    def take(self, key: Key) -> None:
        """It is no longer here."""
        self._total -= self._sizes.pop(key, 0)


def size_of_model(model: RegionModel) -> int:
    """Bytes, of its arrays."""
    return model.ranges.nbytes + model.index.nbytes + size_of_space(model.space)


def size_of_space(space: RegionSpace) -> int:
    """Bytes, of its array."""
    return space.space.vectors.nbytes
