"""A region's model as a file that numpy.load opens."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np
from eigenscan.eigenspace.analysis import RegionSpace
from eigenscan.eigenspace.archive import DAMAGE, opened
from eigenscan.eigenspace.components import Eigenspace
from eigenscan.eigenspace.embedding import Embedding
from eigenscan.eigenspace.model import ModelError, RegionModel
from numpy.lib import format as npy

_PLAIN = ("region", "frame_id", "spacing", "origin", "index", "ranges", "range_unit", "outline")
_COMPRESSION = 1
"""zlib level, as on the wire; np.savez_compressed's takes four times as long."""


def pack_region(model: RegionModel) -> bytes:
    """The content of a model's file."""
    content = BytesIO()
    with ZipFile(content, "w", ZIP_DEFLATED, compresslevel=_COMPRESSION) as file:
        for name, array in _arrays(model).items():
            with file.open(f"{name}.npy", "w") as member:
                npy.write_array(member, np.asarray(array), allow_pickle=False)
    return content.getvalue()


def _arrays(model: RegionModel) -> dict[str, Any]:
    arrays: dict[str, Any] = {name: getattr(model, name) for name in _PLAIN}
    arrays |= space_arrays(model.space)
    entry = model.entry
    return arrays | {
        "version": entry.version,
        "wire_bytes": entry.size,
        "walls_in_sight": entry.walls_in_sight,
    }


def read_region(path: Path, version: str) -> RegionModel:
    """Reads the model in `path`. Raises ModelError if it is unreadable or has another version."""
    try:
        with opened(path) as file:
            model = _from_arrays(file)
        found = model.version
        model.check()
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error
    except (AttributeError, *DAMAGE) as error:
        raise ModelError(f"{path}: is no region of a model: {error}") from error
    if found != version:
        raise ModelError(f"{path}: content is not the version {version[:12]} of the manifest: build again")
    return model


def _from_arrays(file: Any) -> RegionModel:
    return RegionModel(
        region=str(file["region"]),
        frame_id=str(file["frame_id"]),
        spacing=float(file["spacing"]),
        origin=file["origin"],
        index=file["index"],
        ranges=file["ranges"],
        space=space_of_arrays(file),
        outline=file["outline"],
        range_unit=float(file["range_unit"]),
    )


def space_arrays(one: RegionSpace) -> dict[str, Any]:
    """A space as arrays by name."""
    space = one.space
    return {
        "embedding": one.embedding.kind,
        "cap": one.embedding.cap,
        "mean": space.mean,
        "vectors": space.vectors,
        "eigenvalues": space.eigenvalues,
        "total_variance": space.total_variance,
        "usual_error": one.usual_error,
    }


def space_of_arrays(file: Any) -> RegionSpace:
    """Inverse of space_arrays. Raises KeyError or ValueError."""
    kind: Any = str(file["embedding"])
    return RegionSpace(
        Embedding(kind, float(file["cap"])),
        Eigenspace(file["mean"], file["vectors"], file["eigenvalues"], float(file["total_variance"])),
        float(file["usual_error"]),
    )
