"""The associations by name."""

from __future__ import annotations

from typing import Literal

from eigenscan.projector.association.manifold import Association, Sheets
from eigenscan.projector.association.sweep import SweepTable

Kind = Literal["sweep"]


def association(kind: Kind, regions: list[Sheets]) -> Association:
    """The association `kind` with the sheets of all regions."""
    makers = {"sweep": SweepTable.of}
    return makers[kind](regions)
