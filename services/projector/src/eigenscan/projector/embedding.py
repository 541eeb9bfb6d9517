"""What of a range enters the eigenspace: the paper's clipped range, or its place on a ring.

On a ring a range is an angle, 2 pi r / circumference, and enters as cosine and sine. Two ranges are then
never farther apart than the ring's diameter: a beam that is wrong by metres (a person, an open door) counts
little more than one that is wrong by a metre, where in plain ranges it counts with the square of its error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Kind = Literal["ring", "range"]

CIRCUMFERENCE = 10.0
"""m around the ring: a quarter of it, 2.5 m, is what two ranges can differ by before more says no more."""
RING_CAP = 1.2 * CIRCUMFERENCE
"""m: all walls beyond lie at one place of the ring, among the near ones and not opposite to them."""


@dataclass(frozen=True)
class Embedding:
    """Ranges (...,) to channels (F, ...): F = 2 on a ring, in metres of the chord; F = 1 for plain ranges."""

    kind: Kind
    cap: float

    @property
    def channels(self) -> int:
        """F."""
        return 2 if self.kind == "ring" else 1

    @classmethod
    def of(cls, kind: Kind, range_cap: float, range_max: float) -> Embedding:
        """Embedding for a sensor; plain ranges are clipped to `range_cap`, m; `range_max` 0: not limited."""
        limit = range_max if range_max > 0 else np.inf
        return cls(kind, min(RING_CAP if kind == "ring" else range_cap, limit))

    def __call__(self, ranges: ArrayLike) -> NDArray[np.float32]:
        """Channels of ranges, m; +inf counts as the cap."""
        clipped = np.minimum(np.asarray(ranges, dtype=np.float32), np.float32(self.cap))
        if self.kind == "range":
            return clipped[None]
        radius = CIRCUMFERENCE / (2.0 * np.pi)
        angle = clipped / np.float32(radius)
        return np.stack([np.cos(angle), np.sin(angle)]) * np.float32(radius)
