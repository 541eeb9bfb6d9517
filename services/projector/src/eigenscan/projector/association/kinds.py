"""The associations by name, each imported where it is asked for: the names alone are settings, and quick."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from eigenscan.projector.association.manifold import Association, Sheets

Kind = Literal["sweep", "cells", "tree", "connectivity", "triangles", "tetrahedra"]


def association(kind: Kind, regions: list[Sheets], margin: float) -> Association:
    """The association `kind` with the sheets of all regions; `margin` as of Tetrahedra and Triangles."""
    match kind:
        case "sweep":
            from eigenscan.projector.association.sweep import SweepTable

            return SweepTable.of(regions)
        case "cells":
            from eigenscan.projector.association.cells import CellTable

            return CellTable.of(regions)
        case "tree":
            from eigenscan.projector.association.tree import Trees

            return Trees.of(regions)
        case "connectivity":
            from eigenscan.projector.association.surfaces import Surfaces

            return Surfaces.of(regions)
        case "triangles":
            from eigenscan.projector.association.triangles import Triangles

            return Triangles.of(regions, margin)
        case "tetrahedra":
            from eigenscan.projector.association.tetrahedra import Tetrahedra

            return Tetrahedra.of(regions, margin)
