"""Judges a demo: was the robot found, and found again? Its end and exit code follow from this."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np
from eigenscan.geometry.circle import difference
from eigenscan.geometry.pose import Array

NEAR_M = 0.5
NEAR_RAD = np.deg2rad(10.0)
"""A pose within both of the truth is right (the protocol of evaluation)."""

ENOUGH = 10
"""Right poses in a row, up to the end, that make a robot found: no lucky guess lasts a second."""

SILENCE_S = 2.0
"""A claim older than this at the end of a stretch does not count."""


@dataclass(frozen=True)
class Sighting:
    """One pose of the tracker beside the truth of the same time."""

    time: float  # s since the first scan
    pose: Array  # (3,) map frame
    truth: Array  # (3,)
    claimed: bool  # the state was LOCALIZED
    confidence: float
    candidates: int = 0  # tracks in play

    @property
    def error_m(self) -> float:
        """Distance to the truth, m."""
        return float(np.hypot(*(self.pose - self.truth)[:2]))

    @property
    def error_rad(self) -> float:
        """Difference in heading, rad, >= 0."""
        return float(abs(difference(self.pose[2], self.truth[2])))

    @property
    def right(self) -> bool:
        """Within 0.5 m and 10 deg."""
        return self.error_m <= NEAR_M and self.error_rad <= NEAR_RAD


@dataclass(frozen=True)
class Stretch:
    """The time between two cold starts."""

    found_after: float | None  # s until the claims that are right to the end; None: not found
    scans: int  # sightings until then, that one included
    noticed_after: float | None  # s until the first sighting that is no wrong claim
    error_m: float  # medians over the right claims since it was found; NaN without
    error_rad: float
    confidence: float
    claims: int
    wrong_claims: int
    candidates: int = 0  # most tracks in play until then

    @property
    def found(self) -> bool:
        """The robot was localized, rightly and to the end."""
        return self.found_after is not None

    @property
    def figures(self) -> dict[str, float | int | None]:
        """The same for scripts; None for missing numbers."""
        return {
            name: value if value is None or isfinite(value) else None for name, value in vars(self).items()
        }


def judge(sightings: Sequence[Sighting], start: float, end: float) -> Stretch:
    """Stretch of `sightings` with start <= time < end, s."""
    own = [sighting for sighting in sightings if start <= sighting.time < end]
    claims = [sighting for sighting in own if sighting.claimed]
    tail = _right_to_the_end(claims)
    settled = len(tail) >= ENOUGH and end - tail[-1].time <= SILENCE_S
    searching = [sighting for sighting in own if not tail or sighting.time < tail[0].time]
    honest = next((sighting for sighting in own if sighting.right or not sighting.claimed), None)
    return Stretch(
        found_after=tail[0].time - start if settled else None,
        scans=sum(sighting.time <= tail[0].time for sighting in own) if settled else 0,
        noticed_after=honest.time - start if honest else None,
        error_m=_median([sighting.error_m for sighting in tail]),
        error_rad=_median([sighting.error_rad for sighting in tail]),
        confidence=_median([sighting.confidence for sighting in tail]),
        claims=len(claims),
        wrong_claims=sum(not sighting.right for sighting in claims),
        candidates=max((sighting.candidates for sighting in searching), default=0),
    )


def _right_to_the_end(claims: Sequence[Sighting]) -> Sequence[Sighting]:
    wrong = [index for index, sighting in enumerate(claims) if not sighting.right]
    return claims[wrong[-1] + 1 :] if wrong else claims


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
