"""Finished regions of a build, each in a file, so that they need not be built again.

MODEL.pieces/ lies beside the future MODEL. A piece is named by the hash of all inputs of its model, appears
whole or not at all, and is checked before use.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from eigenscan.eigenspace.archive import DAMAGE, opened
from eigenscan.eigenspace.floors import Floor
from eigenscan.eigenspace.folder import check_place, publish
from eigenscan.eigenspace.model import ModelError, set_of
from eigenscan.eigenspace.region_file import read_region, space_of_arrays
from eigenscan.geometry.gridmap import GridMap
from eigenscan.schemas.model_pb2 import ModelSet


@dataclass(frozen=True)
class Piece:
    """A finished region: its file, its entry in a set, and the share of the variance that its space holds."""

    path: Path
    entry: ModelSet.Entry
    explained: float


class Pieces:
    """The finished regions of a model `folder`. Use `with`: one build at a time.

    Raises ModelError if the folder is no model folder, another build uses it, or the pieces cannot be
    written.
    """

    def __init__(self, folder: Path) -> None:
        check_place(folder)
        real = folder.resolve()  # the folder "." has no name
        self.folder, self.place = folder, real.with_name(real.name + ".pieces")
        self._lock: IO[str] | None = None

    def __enter__(self) -> Pieces:
        try:
            while self._lock is None:
                self._lock = self._locked()
        except OSError as error:
            if isinstance(error, BlockingIOError):
                raise ModelError(f"{self.folder}: another build is at it: wait for it, or stop it") from error
            raise ModelError(f"{self.place}: cannot be written: {error.strerror}: check the place") from error
        return self

    def _locked(self) -> IO[str] | None:
        """The lock; None if the build before has just deleted it with its pieces. Raises OSError."""
        self.place.mkdir(parents=True, exist_ok=True)
        path = self.place / "lock"
        with ExitStack() as closing:
            lock = closing.enter_context(path.open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if not (path.exists() and os.path.samestat(os.fstat(lock.fileno()), path.stat())):
                return None
            closing.pop_all()
            return lock

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._lock is not None
        if error is None or not any(self.place.glob("*.npz")):
            shutil.rmtree(self.place, ignore_errors=True)
        self._lock.close()

    def find(self, key: str) -> Piece | None:
        """The piece of that key; None if it is missing or damaged."""
        try:
            piece = _described(self._path(key))
            read_region(piece.path, piece.entry.version)
        except (OSError, *DAMAGE):
            return None
        return piece

    def keep(self, key: str, content: bytes) -> Piece:
        """Writes a piece. Raises ModelError if it cannot."""
        path = self._path(key)
        try:
            path.with_suffix(".half").write_bytes(content)
            path.with_suffix(".half").rename(path)
        except OSError as error:
            raise ModelError(f"{path}: cannot be written: {error.strerror}: make room, run again") from error
        return _described(path)

    def publish(
        self,
        pieces: Mapping[str, Piece],
        grid: GridMap,
        frame_id: str,
        picture: bytes | None,
        outlines: str | None,
        floors: Sequence[Floor] = (),
    ) -> ModelSet:
        """The pieces by their regions' names as the model folder, in one step. Raises ModelError."""
        entries = [piece.entry for _, piece in sorted(pieces.items())]
        apart = [floor.to_message() for floor in floors]
        message = set_of(entries, grid.version, frame_id, grid.free_area, apart)

        def put(regions: Path) -> None:
            for name, piece in pieces.items():
                _link(piece.path, regions / f"{name}.npz")

        publish(self.folder, grid, message, put, picture, outlines)
        return message

    def _path(self, key: str) -> Path:
        return self.place / f"{key[:32]}.npz"


def _described(path: Path) -> Piece:
    with opened(path) as file:
        entry = ModelSet.Entry(
            region=str(file["region"]),
            version=str(file["version"]),
            size=int(file["wire_bytes"]),
            walls_in_sight=float(file["walls_in_sight"]),
        )
        return Piece(path, entry, space_of_arrays(file).space.explained)


def _link(piece: Path, target: Path) -> None:
    try:
        target.hardlink_to(piece)
    except OSError:  # some file systems have no links
        shutil.copyfile(piece, target)
