"""What a projector can be told."""

from __future__ import annotations

from eigenscan.runtime.settings import ServiceSettings
from pydantic import Field


class ProjectorSettings(ServiceSettings):
    """Candidate poses and obstacles from one scan, by the eigenspaces of the site's regions."""

    components: int = Field(8, ge=1, le=64, description="coefficients kept of each subspace")
    candidates: int = Field(2000, ge=1, description="nearest poses in eigenspace that are verified")
    refined: int = Field(60, ge=1, description="verified poses that are polished below the grid")
    published: int = Field(30, ge=1, le=30, description="hypotheses of a scan at most")
    range_cap: float = Field(15.0, gt=0, description="m, farther ranges count as this far in eigenspace")
    least_beams: int = Field(12, ge=1, description="beams with a return that a scan needs, at 2 degrees")
