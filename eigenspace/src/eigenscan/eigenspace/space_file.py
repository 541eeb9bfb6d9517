"""Eigenspaces for one kind of lidar, of many regions, in a file beside their models."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from eigenscan.eigenspace.analysis import RegionSpace
from eigenscan.eigenspace.archive import DAMAGE, opened
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.region_file import space_arrays, space_of_arrays
from eigenscan.eigenspace.space_message import space_from_message, space_to_message


def write_spaces(made: Mapping[str, RegionSpace], path: Path) -> None:
    """Writes spaces by the version of the region's model, whole or not at all. Raises OSError."""
    path.parent.mkdir(exist_ok=True)  # a model folder that is gone stays gone
    arrays = [space_arrays(own) for own in made.values()]
    partial = path.with_suffix(f".{os.getpid()}.part")
    try:
        with partial.open("wb") as file:
            np.savez(
                file,
                allow_pickle=False,
                versions=np.array(list(made)),
                **{name: np.stack([np.asarray(one[name]) for one in arrays]) for name in arrays[0]},
            )
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def read_spaces(path: Path) -> dict[str, RegionSpace]:
    """Inverse of write_spaces. Raises ModelError for another file, or for invalid spaces."""
    try:
        with opened(path) as file:
            arrays = {name: file[name] for name in file.files}
        versions = arrays.pop("versions").tolist()
        found = {
            str(version): space_of_arrays({name: array[r] for name, array in arrays.items()})
            for r, version in enumerate(versions)
        }
        for own in found.values():
            space_from_message(space_to_message(own))  # raises for spaces that the wire would refuse
        if not found or len({own.analysis for own in found.values()}) > 1:
            raise ValueError("expected spaces of one analysis")
    except (OSError, *DAMAGE) as error:
        raise ModelError(f"{path}: holds no eigenspaces: {error}") from error
    return found
