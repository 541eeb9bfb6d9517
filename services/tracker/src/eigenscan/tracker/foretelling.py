"""A pose at once: what a scan leads to before odometry of its time has come, by the last velocity.

A twin of the tracker takes the step, as if odometry had gone on to the scan's stamp as it went before. The
tracker itself waits as ever: its own step is by what odometry then says, so its state is as without this.

By stamps alone: the twin knows odometry up to the scan's stamp, even where later odometry has already come.
So it matters neither how long the projector took nor whether a recording is replayed.
"""

from __future__ import annotations

from collections import deque
from enum import Enum
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel

T = TypeVar("T")


def twin(original: T, instead: dict[int, Any]) -> T:
    """A copy that may change without the original; what is frozen they share.

    `instead`: by id, what takes the place of parts.
    """
    known = instead.get(id(original))
    if known is not None:
        return known  # type: ignore[no-any-return]
    made: Any = original
    if isinstance(original, np.ndarray):
        made = original.copy()
    elif isinstance(original, dict):
        made = original.copy()
        for key, value in original.items():
            made[key] = twin(value, instead)
    elif isinstance(original, (list, deque)):
        made = original.copy()
        for n, value in enumerate(original):
            made[n] = twin(value, instead)
    elif _changes(original):
        made = object.__new__(type(original))
        instead[id(original)] = made
        for name, value in vars(original).items():
            made.__dict__[name] = twin(value, instead)
    return made  # type: ignore[no-any-return]


def _changes(thing: object) -> bool:
    """Whether it is an object of the tracker's that is not frozen."""
    if isinstance(thing, (BaseModel, Enum)) or not type(thing).__module__.startswith("eigenscan.tracker."):
        return False
    parameters = getattr(thing, "__dataclass_params__", None)
    return parameters is None or not parameters.frozen
