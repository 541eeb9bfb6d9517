"""Tables of a site's regions for one kind of lidar, made region by region when scans need them.

A scan waits for at most PER_SCAN regions, those that explain it best. The regions that it then searches
depend only on earlier messages. Work aside only makes tables earlier.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE, Analysis, RegionSpace, sampled
from eigenscan.eigenspace.model import RegionModel
from eigenscan.projector.association.kinds import association
from eigenscan.projector.association.manifold import Association, Sheets
from eigenscan.projector.association.ratios import Ratios
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.lattice import Lattice
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.subspaces import Subspaces
from numpy.typing import NDArray

Flags = NDArray[np.bool_]
Given = Mapping[tuple[str, Analysis], RegionSpace]
"""Received spaces, by the version of the region's model and their analysis."""

TABLE = 1
"""Counts changes of how a table is made: kept ones of an earlier kind are not used."""
PER_SCAN, DERIVED_PER_SCAN = 64, 32
"""Regions that a scan waits for at most; fewer where their spaces are derived: benchmarks/first_scan.py."""
LARGEST = 3.0
"""Coefficients beyond count as this, in roots of the largest eigenvalue of all regions: scans are bounded,
and their coefficients reach 2 to 3 of them."""
HEADINGS = ANALYSIS_TURN // HEADING_STRIDE


Arrays = dict[str, NDArray[Any]]


class Store(Protocol):
    """Arrays that an earlier process kept, and a place for those of this one."""

    @property
    def counts(self) -> Mapping[str, int]:
        """Arrays loaded, saved and rejected, by reason."""
        ...

    def load(self, name: str, like: Mapping[str, NDArray[Any]]) -> Arrays | None:
        """Arrays saved as `name`, writable; None if there are none, or of other shapes or types."""
        ...

    def save(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Saves arrays in place of those with that name."""
        ...

    def set_aside(self, name: str) -> None:
        """Records that part of the loaded arrays is damaged."""
        ...


class Tables:
    """Eigenspaces and coefficients of the R regions for one kind of lidar.

    `ready` (R,): the regions that a scan may search. `usual_error` (R,), m^2, as of RegionSpace.
    """

    def __init__(
        self,
        models: Sequence[RegionModel],
        lattice: Lattice,
        analysis: Analysis,
        settings: ProjectorSettings,
        given: Given,
        store: Store | None = None,
    ) -> None:
        self.models, self.analysis, self._lattice, self._given = models, analysis, lattice, given
        self.abandoned = False
        components = min(analysis.components, analysis.embedding.channels * analysis.beams)
        shape = len(models), components, analysis.embedding.channels, analysis.beams
        self.subspaces, self.usual_error = Subspaces.reserved(*shape), np.ones(len(models))
        self.ready, self._made, self._known = (np.zeros(len(models), dtype=bool) for _ in range(3))
        self._store, self._sums = store, None if store is None else np.zeros(len(models), dtype=np.uint32)
        self._unchecked, self._all_known = np.zeros(len(models), dtype=bool), False
        self._learn()
        self.ratios: Ratios | None = None
        if settings.association == "sweep" and settings.interpolation != "ratios":
            sizes = [len(which) * HEADINGS for which in lattice.searched]
            self.sweep: SweepTable | None = SweepTable.reserved(sizes, components, self._largest())
            self.association: Association = self.sweep
            self._load()
        else:
            self.sweep = None
            sheets = [self._sheets(r) for r in range(len(models))]
            self.association = association(settings.association, sheets, settings.margin)
            if settings.interpolation == "ratios":
                self.ratios = Ratios.of(sheets)
            self._made[:] = self.ready[:] = True

    @property
    def is_known(self) -> bool:
        """Whether the eigenspaces of all regions are published or received."""
        if not self._all_known:
            self._learn()
            self._all_known = bool(self._known.all())
        return self._all_known

    @property
    def patience(self) -> int:
        """Regions that the next scan waits for at most."""
        return PER_SCAN if self.is_known else DERIVED_PER_SCAN

    @property
    def made(self) -> int:
        """Regions that no scan has to wait for."""
        return int(np.count_nonzero(self._made | self._unchecked))

    def admit(self, wanted: Flags, order: NDArray[np.float64]) -> None:
        """Prepares some of the regions `wanted` (R,), those with the least `order` (R,) first."""
        waiting = np.flatnonzero(wanted & ~self.ready)
        for r in waiting[np.argsort(order[waiting], kind="stable")][: self.patience]:
            self._make(int(r))
            self.ready[r] = True

    def complete(self) -> None:
        """Makes all regions ready."""
        for r in np.flatnonzero(~self.ready):
            self._make(int(r))
            self.ready[r] = True

    def work_aside(self) -> None:
        """Prepares the remaining regions for later scans; no answer depends on its progress."""
        if self.sweep is None:
            return
        for r in range(len(self.models)):
            if self.abandoned:
                return
            self._make(r)
        self._save()

    def _learn(self) -> None:
        """Takes the spaces published for this kind of lidar, or received since."""
        for r in np.flatnonzero(~self._known):
            model = self.models[int(r)]
            own = model.space if model.space.analysis == self.analysis else None
            own = own or self._given.get((model.version, self.analysis))
            if own is not None:
                self._put(int(r), own)
                self._known[r] = True

    def _put(self, r: int, own: RegionSpace) -> None:
        self.subspaces.put(r, own.space)
        self.usual_error[r] = own.usual_error

    def _make(self, r: int) -> None:
        """Fills the table of region r. To do so twice changes nothing, so two threads may."""
        if self._made[r]:
            return
        if self._unchecked[r]:
            self._unchecked[r] = False
            if self._sums is not None and self._sum(r) == self._sums[r]:
                self._made[r] = True
                return
            if self._store is not None:
                self._store.set_aside(self._name)
        sheets, sweep = self._sheets(r), self.sweep
        assert sweep is not None  # other associations are made at once
        sweep.fill(r, sheets.coefficients.reshape(sheets.rows, -1))
        self._made[r] = True

    def _sheets(self, r: int) -> Sheets:
        lattice, model = self._lattice, self.models[r]
        which = lattice.searched[r]
        own = self._given.get((model.version, self.analysis))
        if model.space.analysis == self.analysis:
            own = model.space
        if own is None:
            own, held = model.derive(self.analysis)
            self._put(r, own)
        else:
            held = sampled(lattice.panoramas[which], own.embedding, own.space)
        return Sheets(held, lattice.positions[which], lattice.cells[r])

    @property
    def _name(self) -> str:
        """Identifies these regions and this analysis."""
        what = repr((TABLE, self.analysis, [model.version for model in self.models]))
        return f"{self.analysis.name}-{hashlib.sha256(what.encode()).hexdigest()[:24]}"

    def _arrays(self) -> Arrays:
        assert self.sweep is not None
        of_table = {name: getattr(self.sweep, name) for name in ("blocks", "centres", "rows")}
        of_spaces = {name: getattr(self.subspaces, name) for name in ("mean", "vectors", "prior")}
        return {**of_table, **of_spaces, "usual_error": self.usual_error}

    def _load(self) -> None:
        """Loads saved tables; each region is checked on first use."""
        if self._store is None or self.sweep is None or self._sums is None:
            return
        kept = self._store.load(self._name, {**self._arrays(), "sums": self._sums})
        if kept is None:
            return
        self._sums = kept["sums"]
        blocks, centres, rows = kept["blocks"], kept["centres"], kept["rows"]
        self.association = self.sweep = replace(self.sweep, blocks=blocks, centres=centres, rows=rows)
        for own, name in ((self.subspaces, "mean"), (self.subspaces, "vectors"), (self.subspaces, "prior")):
            getattr(own, name)[~self._known] = kept[name][~self._known]
        self.usual_error[~self._known] = kept["usual_error"][~self._known]
        self._unchecked[:] = True

    def _save(self) -> None:
        """Saves all tables, unless they are saved already."""
        if self._store is not None and self._sums is not None and self._made.all():
            sums = np.array([self._sum(r) for r in range(len(self.models))], dtype=np.uint32)
            if not np.array_equal(sums, self._sums):
                self._sums = sums
                self._store.save(self._name, {**self._arrays(), "sums": sums})

    def _sum(self, r: int) -> int:
        """Checksum of all that is kept of region r."""
        assert self.sweep is not None
        first, last = self.sweep.bounds[r], self.sweep.bounds[r + 1]
        own = [array[r] for array in (self.subspaces.mean, self.subspaces.vectors, self.subspaces.prior)]
        table = [
            self.sweep.blocks[first:last],
            self.sweep.centres[:, first:last],
            self.sweep.rows[first:last],
        ]
        total = 0
        for array in (*own, self.usual_error[r], *table):
            total = zlib.crc32(np.ascontiguousarray(array).tobytes(), total)
        return total

    def _largest(self) -> float:
        """The largest coefficient to distinguish, m: the declared lidar's, times the wider view."""
        declared = max(float(model.space.space.eigenvalues[0]) for model in self.models)
        wider = self.analysis.beams / self.models[0].space.space.beams
        return LARGEST * float(np.sqrt(declared * max(wider, 1.0)))
