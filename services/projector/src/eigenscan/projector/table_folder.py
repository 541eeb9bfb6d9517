"""Keeps tables on disk: a folder for each kind of lidar and model set, a file for each array.

They are mapped, not read, so unsearched parts cost nothing. Unusable files are renamed.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.eigenspace.archive import DAMAGE
from numpy.typing import NDArray

Arrays = dict[str, NDArray[Any]]

KEPT = 6
"""Sets of arrays: two versions of a site's models for three lidars. Those used longest ago go first."""
ASIDE = ".damaged"
LEFT_S = 3600.0
"""Age, s, from which an unfinished folder was left behind: no array takes so long to write."""


class TableFolder:
    """A Store (see tables) in `folder`. `counts`: arrays loaded, saved and rejected, by reason."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._counts: Counter[str] = Counter()

    @property
    def counts(self) -> Mapping[str, int]:
        """Arrays loaded, saved and rejected, by reason."""
        return dict(self._counts)

    def load(self, name: str, like: Mapping[str, NDArray[Any]]) -> Arrays | None:
        """Arrays saved as `name`, mapped copy-on-write; None if none have these shapes and types."""
        place = self._folder / name
        if not place.is_dir():
            return None
        found: Arrays = {}
        try:
            for part, wanted in like.items():
                # a plain array: compiled code takes a mapped one for another type
                array = np.asarray(np.load(place / f"{part}.npy", mmap_mode="c", allow_pickle=False))
                if array.shape != wanted.shape or array.dtype != wanted.dtype:
                    raise ValueError(f"{part}: {array.dtype} {array.shape}")
                found[part] = array
            with suppress(OSError):  # a folder that may only be read
                place.touch()
        except (OSError, *DAMAGE):
            self.set_aside(name)
            return None
        self._counts["tables_taken"] += 1
        return found

    def save(self, name: str, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Saves arrays in place of those with that name; whole or not at all."""
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            fresh = Path(tempfile.mkdtemp(prefix=".", dir=self._folder))
            try:
                for part, array in arrays.items():
                    np.save(fresh / f"{part}.npy", array, allow_pickle=False)
                shutil.rmtree(self._folder / name, ignore_errors=True)
                fresh.rename(self._folder / name)
            finally:
                shutil.rmtree(fresh, ignore_errors=True)
            self._tidy()
        except OSError:
            self._counts["tables_not_kept"] += 1
        else:
            self._counts["tables_kept"] += 1

    def set_aside(self, name: str) -> None:
        """Renames the arrays saved as `name`, once."""
        self._counts["tables_damaged"] += 1
        aside = self._folder / f"{name}{ASIDE}"
        shutil.rmtree(aside, ignore_errors=True)
        try:
            (self._folder / name).rename(aside)
        except OSError:  # it is set aside, or gone
            return

    def _tidy(self) -> None:
        for path in self._folder.glob(".*"):  # of processes that ended while they saved
            if time.time() - path.stat().st_mtime > LEFT_S:
                shutil.rmtree(path, ignore_errors=True)
        kept = sorted(self._folder.glob("[!.]*"), key=lambda path: path.stat().st_mtime, reverse=True)
        for path in kept[KEPT:]:
            shutil.rmtree(path, ignore_errors=True)


def in_a_thread(work: Any) -> None:
    """Runs `work` in a thread that ends with the process."""
    threading.Thread(target=work, name="tables", daemon=True).start()
