"""Gaussian tracks in arrays (paper, section 7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from eigenscan.geometry.inner import inner
from numba import types
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Tracks:
    """n Gaussian tracks: poses x (n, 3), covariances C (n, 3, 3), masses as logarithms (n,).

    `hidden` (n, sources): share of a track's mass in which the source does not show its pose: of two lidars
    one may see what the map lacks. `alias` (n,): probability that the track, were it wrong, would be shown
    as a right one is.
    `evidence` (n, sources): the evidence of each source's scans from the present place for a track that is
    shown.
    `unchecked` (n, 4): way, m, and turn, rad, since a hypothesis last confirmed the track; and what of both
    no scan motion has confirmed either.
    `fixed_x`, `fixed_covariance` at `fixed_at` (n,), ns: the track where a scan last fixed it.
    `nis` (n,): normalised innovation squared of the last scan's hypothesis, NaN where it had none.
    """

    x: Array
    C: Array
    log_weight: Array
    hidden: Array
    alias: Array
    evidence: Array
    unchecked: Array
    nis: Array
    fixed_x: Array
    fixed_covariance: Array
    fixed_at: Index
    frame: Index
    id: Index
    parent: Index
    born: Index
    observations: Index

    def __len__(self) -> int:
        return len(self.x)

    def pick(self, index: Index | NDArray[np.bool_]) -> Tracks:
        """The tracks at `index`."""
        return _of({name: values[index] for name, values in vars(self).items()})


class Columns(NamedTuple):
    """The same arrays by the same names, in compiled code."""

    x: Array
    C: Array
    log_weight: Array
    hidden: Array
    alias: Array
    evidence: Array
    unchecked: Array
    nis: Array
    fixed_x: Array
    fixed_covariance: Array
    fixed_at: Index
    frame: Index
    id: Index
    parent: Index
    born: Index
    observations: Index


_DIMENSIONS = dict.fromkeys(Columns._fields, 1) | {
    "x": 2, "C": 3, "hidden": 2, "evidence": 2, "unchecked": 2, "fixed_x": 2,
    "fixed_covariance": 3,
}  # fmt: skip
_NUMBERED = ("fixed_at", "frame", "id", "parent", "born", "observations")
_KINDS = [
    (types.int64 if name in _NUMBERED else types.float64, dimensions)
    for name, dimensions in _DIMENSIONS.items()
]
GIVEN = types.Tuple([types.Array(kind, dimensions, "A", readonly=True) for kind, dimensions in _KINDS])
"""What compiled code is given of tracks: `arrays_of` them."""
MADE = types.NamedTuple([types.Array(kind, dimensions, "C") for kind, dimensions in _KINDS], Columns)
"""What it makes: `tracks_of` these."""
Arrays = tuple[Array, Array, Array, Array, Array, Array, Array, Array, Array, Array, Index, Index, Index,
               Index, Index, Index]  # fmt: skip

_GET: Callable[[Tracks], Arrays] = attrgetter(*Columns._fields)


def arrays_of(tracks: Tracks) -> Arrays:
    """What compiled code takes: the arrays in the order of `Columns`."""
    return _GET(tracks)


def tracks_of(made: Columns) -> Tracks:
    """Tracks of what compiled code has made."""
    return _of(made._asdict())


@inner()  # pragma: no cover - compiled
def taken(t: Columns, index: Index) -> Columns:
    """Copies of the rows at `index`."""
    return Columns(
        t.x[index],
        t.C[index],
        t.log_weight[index],
        t.hidden[index],
        t.alias[index],
        t.evidence[index],
        t.unchecked[index],
        t.nis[index],
        t.fixed_x[index],
        t.fixed_covariance[index],
        t.fixed_at[index],
        t.frame[index],
        t.id[index],
        t.parent[index],
        t.born[index],
        t.observations[index],
    )


@inner()  # pragma: no cover - compiled
def joined(a: Columns, b: Columns, c: Columns) -> Columns:
    """Three sets, one after the other."""
    return Columns(
        np.concatenate((a.x, b.x, c.x)),
        np.concatenate((a.C, b.C, c.C)),
        np.concatenate((a.log_weight, b.log_weight, c.log_weight)),
        np.concatenate((a.hidden, b.hidden, c.hidden)),
        np.concatenate((a.alias, b.alias, c.alias)),
        np.concatenate((a.evidence, b.evidence, c.evidence)),
        np.concatenate((a.unchecked, b.unchecked, c.unchecked)),
        np.concatenate((a.nis, b.nis, c.nis)),
        np.concatenate((a.fixed_x, b.fixed_x, c.fixed_x)),
        np.concatenate((a.fixed_covariance, b.fixed_covariance, c.fixed_covariance)),
        np.concatenate((a.fixed_at, b.fixed_at, c.fixed_at)),
        np.concatenate((a.frame, b.frame, c.frame)),
        np.concatenate((a.id, b.id, c.id)),
        np.concatenate((a.parent, b.parent, c.parent)),
        np.concatenate((a.born, b.born, c.born)),
        np.concatenate((a.observations, b.observations, c.observations)),
    )


@inner()  # pragma: no cover - compiled
def begun(
    x: Array, C: Array, log_weight: Array, alias: Array, evidence: Array, frame: int, stamp: int
) -> Columns:
    """New tracks (n,), yet without a number, each from one hypothesis; `evidence` (n, sources)."""
    n = len(x)
    none = np.zeros(n, dtype=np.int64)
    return Columns(
        x, C, log_weight, np.zeros(evidence.shape), alias, evidence, np.zeros((n, 4)), np.full(n, np.nan),
        x.copy(), C.copy(), none + stamp, none + frame, none, none.copy(), none + stamp, none + 1,
    )  # fmt: skip


def replace(tracks: Tracks, **changes: Array | Index) -> Tracks:
    """The tracks with other arrays of these names. dataclasses.replace takes ten times as long."""
    return _of(vars(tracks) | changes)


def join(parts: list[Tracks]) -> Tracks:
    """All tracks of several sets, in order."""
    parts = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        return parts[0]
    own = [vars(part) for part in parts]
    return _of({name: np.concatenate([each[name] for each in own]) for name in own[0]})


def _of(arrays: dict[str, Array | Index]) -> Tracks:
    made = object.__new__(Tracks)
    vars(made).update(arrays)
    return made


def no_tracks(sources: int) -> Tracks:
    """An empty set."""
    none = np.zeros(0, dtype=np.intp)
    return Tracks(
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        np.zeros(0),
        np.zeros((0, sources)),
        np.zeros(0),
        np.zeros((0, sources)),
        np.zeros((0, 4)),
        np.zeros(0),
        np.zeros((0, 3)),
        np.zeros((0, 3, 3)),
        none,
        none,
        none,
        none,
        none,
        none,
    )


def begin(
    x: Array, C: Array, log_weight: Array, alias: Array, evidence: Array, frame: int, stamp: int
) -> Tracks:
    """New tracks (n,), yet without a number, each from one hypothesis; `evidence` (n, sources)."""
    none = np.zeros(len(x), dtype=np.intp)
    return Tracks(
        x,
        C,
        log_weight,
        np.zeros(evidence.shape),
        alias,
        evidence,
        np.zeros((len(x), 4)),
        np.full(len(x), np.nan),
        x.copy(),
        C.copy(),
        none + stamp,
        none + frame,
        none,
        none,
        none + stamp,
        none + 1,
    )
