"""Settings that may change a projector's answers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, get_args

from eigenscan.projector.association import kinds
from eigenscan.schemas.settings import Settings
from pydantic import Field, field_validator

PART = r"[1-9]\d*/[1-9]\d*"
"""Form of `part`."""


class ProjectorSettings(Settings):
    """Candidate poses and obstacles from one scan, by the eigenspaces of the site's regions."""

    gone: ClassVar[Mapping[str, str]] = dict.fromkeys(
        ("embedding", "range_cap", "components"),
        "the models decide it: set it for the mapbuilder, or as an option of eigenscan build",
    )

    association: kinds.Kind = Field(
        "sweep",
        description=f"how near poses are found: {', '.join(get_args(kinds.Kind))}",
    )
    margin: float = Field(
        0.5,
        ge=0,
        le=1,
        description="how far outside a triangle or tetrahedron a scan may lie, as a share of its size",
    )
    interpolation: Literal["enclosing", "ratios"] = Field(
        "enclosing", description="between grid poses: by the enclosing volume, or ratios (paper, 5.2)"
    )
    verification: Literal["walls", "eigenspace"] = Field(
        "walls", description="walls verifies and refines candidates; eigenspace, as in the paper, does not"
    )
    obstacles: Literal["walls", "reconstruction"] = Field(
        "walls", description="what beams are compared with: walls, or the scan's reconstruction (paper, 6)"
    )
    candidates: int = Field(
        3000, ge=1, le=1_000_000, description="nearest poses in the eigenspace that are verified"
    )
    refined: int = Field(
        200,
        ge=2,
        le=1_000_000,
        description="candidates refined below the grid on 1,000 m2; grows with the square root of the area",
    )
    published: int = Field(30, ge=1, le=300, description="most hypotheses published for a scan")
    part: str = Field(
        "1/1",
        pattern=f"^{PART}$",
        description="K/N: search the Kth of N parts of the site; other projectors search the others",
    )
    focus: bool = Field(
        False,
        description="while the tracker is localized, search around its pose, and the whole site once a "
        "second",
    )
    advice: bool = Field(
        True, description="while several places fit, publish the move that would distinguish them"
    )
    advice_reach: float = Field(8.0, gt=0, le=30, description="m, longest way of such a move")
    robot_radius: float = Field(
        0.3, ge=0, description="m: an advised move keeps so far away from the map's walls"
    )
    request_within: float = Field(
        0.3,
        ge=0,
        description="s, by stamps, that a scan waits for a request; with several lidars "
        "less than the tracker's late",
    )
    least_beams: int = Field(
        12, ge=1, description="beams with a return, 2 degrees or more apart, that a scan needs"
    )

    @property
    def share(self) -> tuple[int, int]:
        """K and N of `part`."""
        k, n = self.part.split("/")
        return int(k), int(n)

    @field_validator("part")
    @classmethod
    def _within(cls, value: str) -> str:
        k, n = (int(number) for number in value.split("/"))
        if k > n:
            raise ValueError(f"there is no share {k} of {n}: K is 1 to N")
        return value
