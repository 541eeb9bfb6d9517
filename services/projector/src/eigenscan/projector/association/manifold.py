"""The sampled manifold of a site's scans, and the interface of an association."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True)
class Sheets:
    """One region's family of surfaces in its own eigenspace (paper, section 4): a sheet for each heading.

    `coefficients` (P, H, M): [p, h] is the scan at position p and heading h of H over a full turn.
    `positions` (P, 2) m, map frame, and `cells` (P, 2), their integer places on the searched grid: positions
    whose cells differ by one are neighbours on a sheet.
    """

    coefficients: NDArray[np.float32]
    positions: Array
    cells: Index

    @property
    def rows(self) -> int:
        """P * H."""
        return len(self.positions) * int(self.coefficients.shape[1])

    def links(self) -> tuple[tuple[Index, Index], tuple[Index, Index]]:
        """Pairs of neighbouring positions (k,), (k,): along x, and along y."""
        right, above = self.beside(1, 0), self.beside(0, 1)
        return (
            (np.flatnonzero(right >= 0), right[right >= 0]),
            (np.flatnonzero(above >= 0), above[above >= 0]),
        )

    def beside(self, dx: int, dy: int) -> Index:
        """The position `dx` and `dy` cells away from each position (P,), -1 if there is none."""
        low = self.cells.min(axis=0)
        at = self.cells - low + max(abs(dx), abs(dy))
        grid = np.full(at.max(axis=0) + 1 + max(abs(dx), abs(dy)), -1, dtype=np.int64)
        grid[at[:, 0], at[:, 1]] = np.arange(len(at))
        found: Index = grid[at[:, 0] + dx, at[:, 1] + dy]
        return found


@dataclass(frozen=True)
class Matches:
    """k poses near a scan in eigenspace, in no order.

    `rows` (k,): the pose, counted through regions, positions and headings. `squares` (k,): ||S - S'||^2
    within the subspaces. `between` (k, 3): the scan's place between the grid's poses, from the row's own, m,
    m, rad in the map frame; None without interpolation.
    """

    rows: Index
    squares: NDArray[np.float32]
    between: Array | None = None

    def check(self, rows: int) -> None:
        """Raises ValueError unless these are matches of poses 0 to `rows` - 1: compiled code reads there."""
        k = self.rows.size
        shapes = self.rows.shape, self.squares.shape, (k, 3) if self.between is None else self.between.shape
        if shapes != ((k,), (k,), (k, 3)) or self.rows.dtype.kind not in "iu":
            raise ValueError(
                f"an association gave rows {shapes[0]} {self.rows.dtype}, squares {shapes[1]} and between "
                f"{shapes[2]}: give (k,) integers, (k,) and (k, 3)"
            )
        if k and not 0 <= int(self.rows.min()) <= int(self.rows.max()) < rows:
            raise ValueError(
                f"an association gave rows {self.rows.min()} to {self.rows.max()}, of poses 0 to {rows - 1}"
            )
        if not np.isfinite(self.squares).all():
            raise ValueError("an association gave squares that are not finite")

    @property
    def offsets(self) -> Array:
        """`between` (k, 3), 0 without interpolation."""
        return np.zeros((len(self.rows), 3)) if self.between is None else self.between

    @property
    def sorted_rows(self) -> Index:
        """`rows` in order; a site has fewer than 2^31, and short numbers are sorted in half the time."""
        return np.sort(self.rows.astype(np.int32)).astype(np.int64)

    def take(self, which: Index) -> Matches:
        """The matches `which` (j,), in that order."""
        between = None if self.between is None else self.between[which]
        return Matches(self.rows[which], self.squares[which], between)

    def best(self, count: int) -> Matches:
        """At most `count`, nearest first."""
        few = np.arange(len(self.rows))
        if count < len(few):
            few = np.argpartition(self.squares, count)[:count]
        return self.take(few[np.argsort(self.squares[few], kind="stable")])

    def joined(self, other: Matches) -> Matches:
        """These and the others, in one list."""
        on_grid = self.between is None and other.between is None
        return Matches(
            np.concatenate([self.rows, other.rows]),
            np.concatenate([self.squares, other.squares]),
            None if on_grid else np.concatenate([self.offsets, other.offsets]),
        )

    def by_row(self) -> Matches:
        """Each pose once, by its first match, in the order of the rows."""
        # sorting numbers takes a fifth of the time of sorting their places
        bits = len(self.rows).bit_length()
        keys = np.sort((self.rows << bits) | np.arange(len(self.rows)))
        rows = keys >> bits
        first = np.ones(len(rows), dtype=bool)
        np.not_equal(rows[1:], rows[:-1], out=first[1:])
        return self.take((keys & ((1 << bits) - 1))[first])


class Association(Protocol):
    """Finds the poses whose scans lie near a scan in eigenspace.

    Coefficients are in m: ||S - S'||^2 of two scans, m^2, is the sum over their beams of the
    squared differences of what is analysed of a range (a point on the ring, m; or the range itself, m).
    """

    @classmethod
    def of(cls, regions: list[Sheets], margin: float, /) -> Self:
        """Over the sheets of all R regions of a site, for one sensor. Made once for each, not for each scan.

        A row of a match counts through these in their order: all P * H poses of the first region, position
        by position, then those of the next. `margin`: the share of its size, 0 to 1, by which a scan may lie
        outside of what is interpolated in; who does not interpolate passes over it.
        """
        ...

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        ...

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """At most about `count` matches of all regions, in no order; the same for the same arguments.

        `alphas` (R, M): the scan in each region's space, as the sheets' coefficients; `residuals` (R,):
        ||E||^2 there, m^2: what a space does not hold counts in full, so that ||alpha - alpha'||^2 + ||E||^2
        is comparable across spaces. A region with +inf is not searched.
        """
        ...
