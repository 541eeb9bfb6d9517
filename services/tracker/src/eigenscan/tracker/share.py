"""How far one scan counts beside those before it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Share:
    """How far one scan counts.

    `weight` 0..1: its share in its source's evidence on the present place. `progress`: how far the robot
    moved on since the source's last scan, 1 where the place is a new one. `precision` 0..1: how much of its
    covariance's information is independent of earlier scans. `carried`: probability that the robot was
    carried away since the source's last scan. `broken`: nothing of the source's last list goes on in this
    one. `in_part`: other projectors answer for the same lidar, so that this one may have searched a part of
    the site. `first`: no list of this lidar was before it.
    """

    weight: float
    progress: float
    precision: float
    carried: float = 0.0
    broken: bool = False
    in_part: bool = False
    first: bool = False
