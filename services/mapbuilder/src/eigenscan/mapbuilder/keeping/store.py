"""Files of a kept map: the model folder, its proposal, and the evidence beside it."""

from __future__ import annotations

import json
import os
import tempfile
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.analysis import Analysis, RegionSpace
from eigenscan.eigenspace.archive import DAMAGE, MOST_BYTES, opened
from eigenscan.eigenspace.folder import OUTLINES, SiteModel, read_models, write_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.space_file import read_spaces, write_spaces
from eigenscan.eigenspace.versions import (
    MANIFEST,
    PROPOSAL,
    accept,
    choose_proposal,
    kept_in,
    versions,
    withdraw,
)
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.keeping.evidence import Evidence
from eigenscan.schemas.model_pb2 import ModelSet

_BYTES_A_CELL = 64
"""Most bytes of evidence for a cell."""
PICTURE = "change.png"
GONE = (-1, -1)
"""State of a folder without a manifest."""
SPACES = "spaces"
"""Subfolder of a model folder: eigenspaces for other lidars than the declared one, a file for each kind."""


class Store:
    """A model folder that others may change at any time. Each write appears whole or not at all."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._evidence = folder.with_name(folder.name + ".evidence.npz")
        self._read: tuple[int, int] | None = None
        self._set: ModelSet | None = None
        self._counts: Counter[str] = Counter()

    @property
    def is_writable(self) -> bool:
        """Whether versions can be put beside the folder."""
        return os.access(self.folder.resolve().parent, os.W_OK)

    def renewed(self) -> SiteModel | None:
        """The models in use if they differ from those returned last.

        Raises ModelError, once for each unreadable state of the folder.
        """
        try:
            found = (self.folder / MANIFEST).stat()
        except OSError as error:
            if self._read == GONE:
                return None
            self._read, self._set = GONE, None  # where it comes back as it was, it is news
            raise ModelError(f"{self.folder / MANIFEST}: cannot be read: {error.strerror}") from error
        state = found.st_ino, found.st_mtime_ns
        if state == self._read:
            return None
        before, self._read, self._set = self._set, state, None
        site = read_models(self.folder)
        self._set = site.to_message()  # all of it: the floors' own frames are no part of the version
        return None if self._set == before else site

    @property
    def counts(self) -> Counter[str]:
        """Spaces for other lidars that were kept, could not be, or were damaged and set aside."""
        return self._counts

    def load_spaces(self) -> dict[Analysis, dict[str, RegionSpace]]:
        """Eigenspaces for other lidars that are kept with the models in use."""
        found = {}
        for path in sorted((self.folder / SPACES).glob("*.npz")):
            try:
                made = read_spaces(path)
            except ModelError:
                self._counts["spaces_damaged"] += 1
                with suppress(OSError):
                    path.replace(path.with_suffix(".damaged"))
            else:
                found[next(iter(made.values())).analysis] = made
        return found

    def save_spaces(self, analysis: Analysis, made: Mapping[str, RegionSpace]) -> None:
        """Writes eigenspaces for another lidar beside the models in use, if the folder allows it."""
        try:
            write_spaces(made, self.folder / SPACES / f"{analysis.name}.npz")
        except OSError:
            self._counts["spaces_not_kept"] += 1
        else:
            self._counts["spaces_kept"] += 1

    def drop_spaces(self, analysis: Analysis) -> None:
        """Deletes the eigenspaces of another lidar, if the folder allows it."""
        with suppress(OSError):
            (self.folder / SPACES / f"{analysis.name}.npz").unlink(missing_ok=True)

    def propose(self, site: SiteModel, about: Mapping[str, Any], picture: bytes) -> None:
        """Puts `site` beside the version in use, as the one proposal. Raises ModelError or OSError."""
        from eigenscan.mapbuilder.picture import draw_regions
        from eigenscan.mapbuilder.positions import Positions
        from eigenscan.mapbuilder.shards import Area

        areas = [Area(m.region, Positions(m.index, m.origin, m.spacing), m.outline) for m in site.regions]
        self.withdraw()
        outlines = self.folder / OUTLINES
        write_models(
            site,
            kept_in(self.folder) / site.to_message().version[:12],
            draw_regions(site.grid, areas),
            outlines.read_text(encoding="utf-8") if outlines.is_file() else None,
            {PICTURE: picture, PROPOSAL: json.dumps(about, indent=1).encode() + b"\n"},
        )

    def accept(self) -> None:
        """Puts the proposal into use. Raises ModelError if it was made for another version."""
        accept(self.folder, choose_proposal(versions(self.folder), None, self.folder).folder)

    def withdraw(self) -> None:
        """Deletes the proposal."""
        withdraw(self.folder)

    def load(self, grid: GridMap, visit_s: float) -> Evidence:
        """The evidence of these cells; none if the file is missing, damaged or for other cells."""
        evidence = Evidence.of(grid, visit_s)
        try:
            with opened(self._evidence, MOST_BYTES + _BYTES_A_CELL * grid.cells.size) as file:
                if (
                    np.array_equal(file["cells"], _cells(grid))
                    and int(file["length_ns"]) == evidence.length_ns
                ):
                    evidence.run[:] = file["run"]
                    evidence.struck[:] = file["struck"]
                    evidence.crossed[:] = file["crossed"]
                    evidence.visit = int(file["visit"])
        except (OSError, *DAMAGE):
            return Evidence.of(grid, visit_s)
        return evidence

    def save(self, evidence: Evidence, grid: GridMap) -> None:
        """Replaces the evidence on disk in one step. Raises OSError."""
        with tempfile.NamedTemporaryFile(
            dir=self._evidence.parent, prefix=".evidence.", delete=False
        ) as file:
            try:
                np.savez_compressed(
                    file,
                    allow_pickle=False,
                    cells=_cells(grid),
                    length_ns=evidence.length_ns,
                    visit=evidence.visit,
                    run=evidence.run,
                    struck=evidence.struck,
                    crossed=evidence.crossed,
                )
                file.close()
                Path(file.name).replace(self._evidence)
            finally:
                Path(file.name).unlink(missing_ok=True)


def _cells(grid: GridMap) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Identifies the cells of a map, without their content."""
    return np.array([*grid.cells.shape, grid.resolution, *grid.origin])
