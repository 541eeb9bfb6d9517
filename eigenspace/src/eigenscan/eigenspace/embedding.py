"""Maps a range into the eigenspace: the paper's clipped range, or its place on a ring.

On a ring a range is an angle, 2 pi r / circumference, and enters as cosine and sine. Two ranges are then
never farther apart than the ring's diameter: a beam that is wrong by metres (a person, an open door) counts
little more than one that is wrong by a metre, whereas plain ranges count with the square of the error. A beam
without a wall in sight means "at least this far": it counts as the cap in both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from eigenscan.geometry.normalize import FARTHEST
from numpy.typing import ArrayLike, NDArray

Kind = Literal["ring", "range"]
KINDS: tuple[Kind, ...] = get_args(Kind)

CIRCUMFERENCE = 10.0
"""Length of the ring, m: two ranges that differ by more than a quarter of it, 2.5 m, count little more."""
CAPS: dict[Kind, float] = {"ring": 1.2 * CIRCUMFERENCE, "range": 15.0}
"""m. On the ring all walls beyond lie at one place, among the near ones and not opposite to them."""


@dataclass(frozen=True)
class Embedding:
    """Ranges (...,) to channels (F, ...): F = 2 on a ring, in metres of the chord; F = 1 for plain ranges.

    `cap`, m: longer ranges count as this.
    """

    kind: Kind
    cap: float

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown kind, or a cap that no range has."""
        if self.kind not in KINDS:
            raise ValueError(f"embedding = {self.kind!r}: choose one of {', '.join(KINDS)}")
        if not 0 < self.cap <= FARTHEST:
            raise ValueError(f"range cap = {self.cap}: give metres above 0, at most {FARTHEST:g}")

    @classmethod
    def of(cls, kind: Kind, cap: float | None = None) -> Embedding:
        """An embedding with the usual cap of its kind, unless given."""
        return cls(kind, CAPS[kind] if cap is None else cap)

    @property
    def channels(self) -> int:
        """F."""
        return 2 if self.kind == "ring" else 1

    def __call__(self, ranges: ArrayLike) -> NDArray[np.float32]:
        """Channels of ranges, m; +inf counts as the cap."""
        clipped = np.minimum(np.asarray(ranges, dtype=np.float32), np.float32(self.cap))
        if self.kind == "range":
            return clipped[None]
        radius = CIRCUMFERENCE / (2.0 * np.pi)
        angle = clipped / np.float32(radius)
        channels = np.empty((2, *angle.shape), dtype=np.float32)
        np.cos(angle, out=channels[0])
        np.sin(angle, out=channels[1])
        channels *= np.float32(radius)
        return channels
