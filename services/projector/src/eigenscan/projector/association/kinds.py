"""The associations by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from eigenscan.projector.association.cells import CellTable
from eigenscan.projector.association.manifold import Association, Sheets
from eigenscan.projector.association.surfaces import Surfaces
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.association.tetrahedra import Tetrahedra
from eigenscan.projector.association.tree import Trees
from eigenscan.projector.association.triangles import Triangles

Kind = Literal["sweep", "cells", "tree", "connectivity", "triangles", "tetrahedra"]

_OF_POINTS: dict[Kind, Callable[[list[Sheets]], Association]] = {
    "sweep": SweepTable.of,
    "cells": CellTable.of,
    "tree": Trees.of,
    "connectivity": Surfaces.of,
}
_OF_VOLUMES: dict[Kind, Callable[[list[Sheets], float], Association]] = {
    "triangles": Triangles.of,
    "tetrahedra": Tetrahedra.of,
}


def association(kind: Kind, regions: list[Sheets], margin: float) -> Association:
    """The association `kind` with the sheets of all regions; `margin` as of Tetrahedra and Triangles."""
    return _OF_VOLUMES[kind](regions, margin) if kind in _OF_VOLUMES else _OF_POINTS[kind](regions)
