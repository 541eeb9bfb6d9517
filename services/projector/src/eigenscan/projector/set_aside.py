"""How much a projector holds of what nobody needs yet: who publishes models must not fill its memory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

from eigenscan.eigenspace.analysis import RegionSpace
from eigenscan.eigenspace.model import RegionModel

MOST, MOST_BYTES = 4096, 2**30
"""Of models and of spaces, each."""

Key = TypeVar("Key")


def beyond(sizes: Mapping[Key, int]) -> list[Key]:
    """The oldest of what is held, by its bytes, that are too many. The newest one stays."""
    count, total, found = len(sizes), sum(sizes.values()), []
    for key, size in list(sizes.items())[:-1]:
        if count <= MOST and total <= MOST_BYTES:
            break
        found.append(key)
        count, total = count - 1, total - size
    return found


def size_of_model(model: RegionModel) -> int:
    """Bytes, of its arrays."""
    return model.ranges.nbytes + model.index.nbytes + size_of_space(model.space)


def size_of_space(space: RegionSpace) -> int:
    """Bytes, of its array."""
    return space.space.vectors.nbytes
