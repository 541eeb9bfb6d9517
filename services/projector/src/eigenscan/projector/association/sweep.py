"""The poses nearest to a scan in eigenspace, over all regions at once, coarse to fine.

The poses of a region lie in blocks that are near together in its space, a byte a coefficient. First the
blocks are compared by their centres, then the poses of the nearest blocks one by one. How many blocks are
opened grows with the root of their number, so that both steps stay short on large sites.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.projector.association.manifold import Array, Association, Index, Matches, Sheets
from eigenscan.projector.subspaces import SeenPart
from numba import njit
from numpy.typing import NDArray

BLOCK = 32
"""Poses that lie together: two vectors of single numbers."""
OPENED = 1.5
"""Blocks opened, in geometric means of all blocks and those that the poses looked for would fill."""
HELD = 1e-4
"""Of coefficients that no beam shows, how much they count all the same, for there must be one least."""
ALWAYS = 64
"""Blocks that are opened in addition to those that the wanted poses would fill."""
_STEPS, _LEVELS = 127, 256
"""A coefficient is held as a whole number of 8 bits: up to _STEPS on either side of 0, of _LEVELS values."""
_BINS = 1024
"""Of the costs below the mean, by which the least are chosen."""
_CHUNK = 1024
"""Blocks whose centres are compared in a row where the scan shows all directions."""
_AT_ONCE = 8
"""Coefficients whose differences are added in one pass over a block."""
_O1, _O2, _O3, _O4, _O5, _O6, _O7 = (np.uint64(k * BLOCK) for k in range(1, _AT_ONCE))

Bytes = NDArray[np.int8]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class SweepTable(Association):
    """B blocks of poses, region after region: region r has those from `bounds[r]` to `bounds[r + 1]`.

    `blocks` (B, M, BLOCK): coefficients in units of `unit`, M filled up with zeros to a multiple of 8;
    `centres` (M, B): their means; `rows` (B, BLOCK): the poses, -1 where a region's last block is not full.
    Region r's poses are counted from `starts[r]`.
    `opened` as OPENED.
    """

    blocks: Bytes
    centres: Bytes
    rows: NDArray[np.int32]
    bounds: Index
    unit: float
    starts: Index
    opened: float = OPENED

    @classmethod
    def of(cls, regions: list[Sheets], _margin: float = 0.0) -> SweepTable:
        """Table of all poses of the regions."""
        tables = [r.coefficients.reshape(r.rows, -1) for r in regions]
        largest = max(float(np.abs(table).max(initial=0.0)) for table in tables)
        made = cls.reserved([len(table) for table in tables], tables[0].shape[1], largest)
        for r, table in enumerate(tables):
            made.fill(r, table)
        return made

    @classmethod
    def reserved(cls, sizes: list[int], components: int, largest: float) -> SweepTable:
        """Room for regions with these numbers of poses; each is filled before it is searched.

        Coefficients of more than `largest`, m, count as that.
        """
        bounds = np.cumsum([0, *(-(-size // BLOCK) for size in sizes)])
        count, components = int(bounds[-1]), -(-components // _AT_ONCE) * _AT_ONCE
        return cls(
            np.empty((count, components, BLOCK), dtype=np.int8),
            np.empty((components, count), dtype=np.int8),
            np.empty((count, BLOCK), dtype=np.int32),
            bounds,
            max(largest / _STEPS, 1e-9),
            np.cumsum([0, *sizes]),
        )

    def fill(self, r: int, table: Singles) -> None:
        """Takes the coefficients (n, M) of all poses of region r. The same again changes nothing."""
        packed = np.zeros((len(table), len(self.centres)), dtype=np.int8)
        packed[:, : table.shape[1]] = np.clip(np.rint(table * np.float32(1.0 / self.unit)), -_STEPS, _STEPS)
        first, last = self.bounds[r], self.bounds[r + 1]
        blocks, rows = self.blocks[first:last], np.full((last - first, BLOCK), -1, dtype=np.int32)
        _fill(packed, _in_blocks(packed), int(self.starts[r]), 0, blocks, rows)
        self.rows[first:last] = rows
        self.centres[:, first:last] = np.rint(blocks.mean(axis=2)).T

    @property
    def nbytes(self) -> int:
        """Memory of the index, bytes."""
        return self.blocks.nbytes + self.centres.nbytes + self.rows.nbytes

    def nearest(self, alphas: Array, residuals: Array, count: int) -> Matches:
        """The `count` nearest poses of the blocks opened; see Association."""
        query = np.zeros((len(alphas), len(self.centres)), dtype=np.float32)
        query[:, : alphas.shape[1]] = alphas / self.unit
        return self._search(query, residuals, count, _ALL_SEEN)

    def nearest_to_part(
        self, part: SeenPart, searched: NDArray[np.bool_], lacking: float, count: int
    ) -> Matches:
        """The same by the beams that are seen alone, of the regions `searched` (R,); squares as of all beams.

        Where beams are `lacking`, this share of all, coefficients go together: ||alpha - alpha'||^2 says
        little. What is compared is L'alpha, with the Gram matrix L L' of the eigenvectors' beams seen.
        """
        regions, size = len(part.energy), len(self.centres)
        axes = np.zeros((regions, size, size), dtype=np.float32)
        query, residuals = np.zeros((regions, size), dtype=np.float32), np.full(regions, np.inf)
        _turn(np.flatnonzero(searched), part.gram, part.target, part.energy, axes, query, residuals)
        found = self._search(query / np.float32(self.unit), residuals, count, axes)
        return Matches(found.rows, found.squares / np.float32(1.0 - lacking))

    def _search(self, query: Singles, residuals: Array, count: int, axes: Singles) -> Matches:
        """The `count` nearest to `query` (R, M), in units; `axes` (R, M, M) turn the poses' coefficients."""
        searched = np.flatnonzero(np.isfinite(residuals))
        beside = (residuals / self.unit**2).astype(np.float32)
        filled, blocks = -(-count // BLOCK), int(np.diff(self.bounds)[searched].sum())
        if not blocks:
            return Matches(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.float32))
        opened = max(round(self.opened * np.sqrt(blocks * filled)), filled + ALWAYS)
        rows, squares = _nearest(
            self.blocks, self.centres, self.rows, self.bounds, searched, query, beside, axes, opened, count
        )
        if count < len(rows):
            few = np.argpartition(squares, count - 1)[:count]
            rows, squares = rows[few], squares[few]
        return Matches(rows, (squares * self.unit**2).astype(np.float32))


_ALL_SEEN: Singles = np.empty((0, 0, 0), dtype=np.float32)


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _turn(
    which: Index, gram: Array, target: Array, energy: Array, axes: Singles, query: Singles, residuals: Array
) -> None:
    """Per region L' with L L' = gram, what L'alpha of the scan is, and the error that is left.

    The factor is that of Cholesky, and L q = target gives q = L'alpha without alpha itself.
    """
    size = target.shape[1]
    lower, q = np.zeros((size, size)), np.empty(size)
    for r in which:
        left = energy[r]
        for k in range(size):
            for m in range(k + 1):
                total = gram[r, k, m] + (HELD if m == k else 0.0)
                for j in range(m):
                    total -= lower[k, j] * lower[m, j]
                lower[k, m] = total / lower[m, m] if m < k else np.sqrt(max(total, HELD))
            total = target[r, k]
            for j in range(k):
                total -= lower[k, j] * q[j]
            q[k] = total / lower[k, k]
            left -= q[k] * q[k]
            query[r, k] = q[k]
            for m in range(k + 1):
                axes[r, m, k] = lower[k, m]
        residuals[r] = max(left, 0.0)


# loops here and below: to assign a slice costs seconds of compilation, for the words of its error
@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _in_blocks(table: Bytes) -> Index:
    """Order of the poses (n, M), halved across the widest coefficient until BLOCK are left."""
    order, other = np.arange(len(table)), np.empty(len(table), dtype=np.int64)
    starts, stops = [0], [len(table)]
    counts = np.empty(_LEVELS, dtype=np.int64)
    while starts:
        start, stop = starts.pop(), stops.pop()
        if stop - start <= BLOCK:
            continue
        m = _widest(table, order[start:stop])
        left = -(-((stop - start) // 2) // BLOCK) * BLOCK
        counts[:] = 0
        for i in range(start, stop):
            counts[int(table[order[i], m]) + _LEVELS // 2] += 1
        level, ties = 0, left
        while ties > counts[level]:
            ties -= counts[level]
            level += 1
        below, above = start, start + left
        for i in range(start, stop):
            key = int(table[order[i], m]) + _LEVELS // 2
            if key < level or (key == level and ties > 0):
                ties -= key == level
                other[below] = order[i]
                below += 1
            else:
                other[above] = order[i]
                above += 1
        for i in range(start, stop):
            order[i] = other[i]
        starts += [start, start + left]
        stops += [start + left, stop]
    return order


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _widest(table: Bytes, members: Index) -> int:
    low, high = table[members[0]].copy(), table[members[0]].copy()
    for i in members:
        for m in range(table.shape[1]):
            low[m], high[m] = min(low[m], table[i, m]), max(high[m], table[i, m])
    best, width = 0, -1
    for m in range(table.shape[1]):
        if int(high[m]) - int(low[m]) > width:
            best, width = m, int(high[m]) - int(low[m])
    return best


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _fill(table: Bytes, order: Index, start: int, first: int, blocks: Bytes, rows: NDArray[np.int32]) -> None:
    for k in range(-(-len(order) // BLOCK)):
        for i in range(BLOCK):
            at = k * BLOCK + i
            if at < len(order):
                rows[first + k, i] = start + order[at]
            # a block that is not full holds its last pose several times
            row = order[min(at, len(order) - 1)]
            for m in range(table.shape[1]):
                blocks[first + k, m, i] = table[row, m]


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _nearest(
    blocks: Bytes,
    centres: Bytes,
    rows: NDArray[np.int32],
    bounds: Index,
    searched: Index,
    query: Singles,
    beside: Singles,
    axes: Singles,
    opened: int,
    count: int,
) -> tuple[Index, Singles]:
    near, away = _to_centres(centres, bounds, searched, query, beside, axes)
    chosen = near[away <= _limit_of_sample(away, opened)]
    squares = np.empty((len(chosen), BLOCK), dtype=np.float32)
    # no views within the loop: each is counted
    flat, coefficients, part = blocks.reshape(-1), query.reshape(-1), np.empty(BLOCK, dtype=np.float32)
    components, size, r = query.shape[1], blocks.shape[1] * BLOCK, 0
    turns, wide = axes.reshape(-1), np.empty(size, dtype=np.float32)
    for k in range(len(chosen)):
        b = chosen[k]
        while b >= bounds[r + 1]:
            r += 1
        error = beside[r]
        for i in range(BLOCK):
            part[i] = error
        if len(axes):
            start = np.uint64(b * size)
            for i in range(size):
                wide[i] = flat[start + np.uint64(i)]
            _add_turned(wide, turns, r * components * components, coefficients, r * components, part)
        else:
            for m in range(0, components, _AT_ONCE):
                _add(flat, np.uint64(b * size + m * BLOCK), coefficients, r * components + m, part)
        for i in range(BLOCK):
            squares[k, i] = part[i]
        if b + 1 == bounds[r + 1]:
            # what fills up a region's last block is no pose
            for i in range(BLOCK):
                count += rows[b, i] < 0
    return _collect(rows, chosen, squares, _limit_of_sample(squares.reshape(-1), count))


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _to_centres(
    centres: Bytes, bounds: Index, searched: Index, query: Singles, beside: Singles, axes: Singles
) -> tuple[Index, Singles]:
    """The blocks (b,) of the regions searched, and the squared distances (b,) of their centres."""
    count = 0
    for r in searched:
        count += bounds[r + 1] - bounds[r]
    which, away = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.float32)
    components, done = len(centres), 0
    turns, coefficients = axes.reshape(-1), query.reshape(-1)
    wide, turned = np.zeros(components * BLOCK, dtype=np.float32), np.empty(BLOCK, dtype=np.float32)
    for r in searched:
        for start in range(bounds[r], bounds[r + 1], BLOCK if len(axes) else _CHUNK):
            size = min(BLOCK if len(axes) else _CHUNK, bounds[r + 1] - start)
            part = away[done : done + size]
            for i in range(size):
                which[done + i] = start + i
                part[i] = beside[r]
            if len(axes):
                for m in range(components):
                    for i in range(size):
                        wide[m * BLOCK + i] = centres[m, start + i]
                turned[:] = 0.0
                _add_turned(wide, turns, r * components * components, coefficients, r * components, turned)
                for i in range(size):
                    part[i] += turned[i]
                done += size
                continue
            for m in range(components):
                q, centre = query[r, m], centres[m, start:]
                for i in range(size):
                    d = np.float32(centre[i]) - q
                    part[i] += d * d
            done += size
    return which, away


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _collect(
    rows: NDArray[np.int32], chosen: Index, squares: Singles, limit: np.float32
) -> tuple[Index, Singles]:
    near, distance = np.empty(squares.size, np.int64), np.empty(squares.size, np.float32)
    found = 0
    for k in range(len(chosen)):
        b, least = chosen[k], squares[k, 0]
        for i in range(BLOCK):
            least = min(least, squares[k, i])
        if least > limit:
            continue
        for i in range(BLOCK):
            # a branch would be guessed wrong too often
            near[found], distance[found] = rows[b, i], squares[k, i]
            found += (squares[k, i] <= limit) & (rows[b, i] >= 0)
    return near[:found], distance[:found]


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _add(flat: Bytes, at: np.uint64, query: Singles, m: int, out: Singles) -> None:
    """Adds the squared differences of _AT_ONCE coefficients, written out for the vector units."""
    q0, q1, q2, q3 = query[m], query[m + 1], query[m + 2], query[m + 3]
    q4, q5, q6, q7 = query[m + 4], query[m + 5], query[m + 6], query[m + 7]
    for n in range(BLOCK):
        # unsigned: an index that cannot be negative is not looked at twice
        i = at + np.uint64(n)
        d0, d1 = np.float32(flat[i]) - q0, np.float32(flat[i + _O1]) - q1
        d2, d3 = np.float32(flat[i + _O2]) - q2, np.float32(flat[i + _O3]) - q3
        d4, d5 = np.float32(flat[i + _O4]) - q4, np.float32(flat[i + _O5]) - q5
        d6, d7 = np.float32(flat[i + _O6]) - q6, np.float32(flat[i + _O7]) - q7
        out[n] += d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3 + d4 * d4 + d5 * d5 + d6 * d6 + d7 * d7


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _add_turned(wide: Singles, axes: Singles, row: int, query: Singles, first: int, out: Singles) -> None:
    """The same of coefficients `wide` (M, BLOCK) after they are turned by `axes` (M, M) from `row` on.

    Those are zero below the diagonal.
    """
    components = len(wide) // BLOCK
    turned = np.empty(BLOCK, dtype=np.float32)
    for k in range(components):
        q = query[first + k]
        for n in range(BLOCK):
            turned[n] = -q
        for m in range(k - k % _AT_ONCE, components, _AT_ONCE):
            a = row + k * components + m
            a0, a1, a2, a3 = axes[a], axes[a + 1], axes[a + 2], axes[a + 3]
            a4, a5, a6, a7 = axes[a + 4], axes[a + 5], axes[a + 6], axes[a + 7]
            for n in range(BLOCK):
                i = np.uint64(m * BLOCK + n)
                turned[n] += (
                    a0 * wide[i] + a1 * wide[i + _O1] + a2 * wide[i + _O2] + a3 * wide[i + _O3]
                    + a4 * wide[i + _O4] + a5 * wide[i + _O5] + a6 * wide[i + _O6] + a7 * wide[i + _O7]
                )  # fmt: skip
        # of a number that the compiler does not know, or it writes the steps out one by one
        for n in range(len(out)):
            out[n] += turned[n] * turned[n]


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _limit_of_sample(values: Singles, count: int) -> np.float32:
    """About the `count`-th least of `values`, from a sample; exact for few values."""
    every = max(1, min(count // 128, 16))
    return _limit(values[::every].copy(), -(-count // every))


@njit(cache=True, nogil=True, fastmath=True)  # pragma: no cover - compiled
def _limit(values: Singles, count: int) -> np.float32:
    """A value that at least `count` of `values` do not exceed, and few more."""
    least = values.min()
    greatest: np.float32 = values.max()
    if count >= len(values):
        return greatest
    # what is looked for lies below the mean, or is nearly all
    width = max((values.mean() - least) / np.float32(_BINS), np.float32(1e-6))
    scale = np.float32(1.0) / width
    counts = np.zeros(_BINS + 1, dtype=np.int64)
    for value in values:
        counts[int(min((value - least) * scale, np.float32(_BINS)))] += 1
    level, found = 0, counts[0]
    while found < count:
        level += 1
        found += counts[level]
    if level == _BINS:
        return greatest
    # the edge is rounded
    edge: np.float32 = least + (level + 1) * width * np.float32(1.00001)
    return min(edge, greatest)
