"""The associations by name, each imported when needed, because the settings need only the names."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from eigenscan.projector.association.manifold import Association, Sheets

MODULES = {
    "sweep": "sweep:SweepTable",
    "cells": "cells:CellTable",
    "tree": "tree:Trees",
    "connectivity": "surfaces:Surfaces",
    "triangles": "triangles:Triangles",
    "tetrahedra": "tetrahedra:Tetrahedra",
}
"""Module beside this one, and class in it, of each: the one place that a new association is named in."""

if TYPE_CHECKING:
    Kind = str
else:
    Kind = Literal[tuple(MODULES)]


def association(kind: Kind, regions: list[Sheets], margin: float) -> Association:
    """The association `kind` over the sheets of all regions; `margin` as in `Association.of`."""
    module, _, name = MODULES[kind].partition(":")
    made: type[Association] = getattr(import_module(f"{__package__}.{module}"), name)
    return made.of(regions, margin)
