"""Gaussian tracks in arrays (paper, section 7)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True)
class Tracks:
    """n Gaussian tracks: poses x (n, 3), covariances C (n, 3, 3), masses as logarithms (n,).

    `hidden` (n,): share of a track's mass in which the projector does not show its pose. `alias` (n,):
    probability that the track, were it wrong, would be shown as a right one is. `evidence`
    (n, sources): the evidence of each source's scans from the present place for a track that is shown.
    `unchecked` (n, 2): way, m, and turn, rad, by odometry alone since a hypothesis last confirmed the track.
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
        np.zeros(0),
        np.zeros(0),
        np.zeros((0, sources)),
        np.zeros((0, 2)),
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
        np.zeros(len(x)),
        alias,
        evidence,
        np.zeros((len(x), 2)),
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
