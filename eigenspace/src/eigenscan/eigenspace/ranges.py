"""Range transforms: what of a range enters the analysis.

A beam without a wall in sight says "at least as far as I look". So every range is clipped to a cap, and no
wall counts as the cap: scan and panorama say the same, every panorama is complete, and the covariance of all
headings stays exactly Toeplitz. A monotone curve after the clip weighs near walls against far ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

Curve = Literal["range", "root", "log", "inverse"]


@dataclass(frozen=True)
class RangeTransform:
    """Ranges clipped to `cap` (m), then curved.

    range: r (the paper's); root: sqrt(r); log: log(1 + r); inverse: -1 / (1 + r). All increase with r.
    """

    cap: float
    curve: Curve = "range"

    def __post_init__(self) -> None:
        """Raises ValueError for a cap that is not positive or an unknown curve."""
        if not (np.isfinite(self.cap) and self.cap > 0):
            raise ValueError(f"range cap = {self.cap}: give metres above 0")
        if self.curve not in get_args(Curve):
            raise ValueError(f"range curve = {self.curve!r}: there are {', '.join(get_args(Curve))}")

    def __call__(self, ranges: ArrayLike) -> NDArray[np.float32]:
        """Values of ranges of any shape, m; +inf counts as the cap, NaN (missing) stays NaN."""
        clipped: NDArray[np.float32] = np.clip(
            np.asarray(ranges, dtype=np.float32), 0.0, np.float32(self.cap)
        )
        if self.curve == "root":
            clipped = np.sqrt(clipped)
        elif self.curve == "log":
            clipped = np.log1p(clipped)
        elif self.curve == "inverse":
            clipped = np.divide(np.float32(-1.0), clipped + np.float32(1.0))
        return clipped
