"""Inputs, outputs and answers of each service, as on the contract's page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from eigenscan.schemas.channels import (
    ADVICE,
    CHANNELS,
    HYPOTHESES,
    MAP,
    MODEL,
    MODEL_SET,
    OBSTACLES,
    ODOMETRY,
    POSE,
    SCAN,
    SCAN_MOTION,
    SCAN_RAW,
    SEARCH,
    TRACKS,
    TRANSFORM,
    TRUTH,
    Channel,
)
from eigenscan.workbench.conformance.agreement import (
    model_numbers,
    pose_numbers,
    projection_numbers,
    scan_numbers,
)
from eigenscan.workbench.conformance.receiving import Received
from eigenscan.workbench.conformance.vectors import DRIVE, LIDARS, Vectors

Numbers = Callable[[Sequence[Received], Vectors], tuple[list[str], str]]
"""Returns the differences from the reference, and a text on what was compared."""


@dataclass(frozen=True)
class Profile:
    """A service as a stranger sees it."""

    name: str
    file: str
    """The vectors that it is played."""
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    asks: Channel | None
    """The channel whose messages each need an answer."""
    answers: tuple[Channel, ...]
    """The channels of these answers, each with its input's stamp."""
    reference: tuple[Channel, ...]
    """Channels that its numbers are compared with."""
    numbers: Numbers | None
    """None if the service's numbers cannot be compared."""
    records: bool = False
    """Whether it keeps all that it receives in files."""

    @property
    def latched(self) -> tuple[Channel, ...]:
        """Its inputs that are published only once."""
        return tuple(channel for channel in self.inputs if channel.qos.latched)


PROFILES: dict[str, Profile] = {
    profile.name: profile
    for profile in (
        Profile(
            "scan-ingest", LIDARS, (SCAN_RAW,), (SCAN, SCAN_MOTION), SCAN_RAW, (SCAN,), (SCAN,), scan_numbers
        ),
        Profile(
            "projector",
            DRIVE,
            (MAP, MODEL, MODEL_SET, SEARCH, SCAN),
            (HYPOTHESES, OBSTACLES, ADVICE),
            SCAN,
            (HYPOTHESES,),
            (HYPOTHESES, TRUTH),
            projection_numbers,
        ),
        Profile(
            "tracker",
            DRIVE,
            (ODOMETRY, HYPOTHESES),
            (POSE, TRACKS, TRANSFORM, SEARCH),
            HYPOTHESES,
            (POSE, TRACKS),
            (POSE, TRUTH),
            pose_numbers,
        ),
        Profile("mapbuilder", DRIVE, (), (MAP, MODEL, MODEL_SET), None, (), (MAP, MODEL_SET), model_numbers),
        Profile("recorder", DRIVE, CHANNELS, (), None, (), (), None, records=True),
    )
}
