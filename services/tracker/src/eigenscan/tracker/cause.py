"""Why odometry and scans disagree, in words for the person who can mend it.

Each usual fault predicts another motion from odometry's; the one that predicts the scans' best is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import atan2, cos, degrees, sin

from eigenscan.tracker.agreement import Compared, distances2
from eigenscan.tracker.odometry import OdometryTrail, motion
from eigenscan.tracker.planar import IDENTITY, Pose, wrap

FAR = 12.0
"""A squared distance beyond it counts no more: it does not fit."""
FITS = 0.4
"""A fault is named if it leaves less than this share of what is left without it."""
LATEST_S, LATE_STEP_S = 8.0, 0.25
"""Scans are tried as so much late, in such steps."""
TURNED = 20.0
"""deg, a mount turned by less cannot be distinguished from slip."""

UNKNOWN = (
    "odometry and scans show different motions: do wheels slip, are stamps of two clocks, "
    "or are the scans of another robot?"
)


def likely_cause(compared: list[Compared], trail: OdometryTrail) -> str:
    """The usual fault that explains most of the comparisons that disagree, or that none does."""
    fitting = [each for each in compared if each.scans is not None]
    if 2 * len(fitting) < len(compared):
        return (
            "scans do not follow from each other: do two robots or two lidars use this name, "
            "or is the lidar covered in part?"
        )
    left = _left(fitting, lambda each: each.odometry)
    best, words = FITS * left, UNKNOWN
    for predicted, cause in _faults(fitting, trail):
        rest = _left(fitting, predicted)
        if rest < best:
            best, words = rest, cause
    return words


def _left(compared: list[Compared], predicted: Callable[[Compared], Pose]) -> float:
    return sum(
        min(sum(distances2(each.scans, predicted(each), each.spread)), FAR)
        for each in compared
        if each.scans is not None
    )


def _faults(
    compared: list[Compared], trail: OdometryTrail
) -> Iterator[tuple[Callable[[Compared], Pose], str]]:
    yield lambda _: IDENTITY, "scans stay the same while odometry moves: is the lidar frozen or covered?"
    yield (
        lambda each: (-each.odometry[0], -each.odometry[1], each.odometry[2]),
        "odometry runs opposite to the scans: is the lidar mounted 180° off, or have the encoders no sign?",
    )
    yield (
        lambda each: (each.odometry[0], -each.odometry[1], -each.odometry[2]),
        "scans turn the other way than odometry: is the lidar mounted upside down, and not stated so?",
    )
    turned = _turned(compared)
    if TURNED < abs(degrees(turned)) < 180.0 - TURNED:
        yield (
            lambda each: _rotated(each.odometry, turned),
            f"scans move {degrees(turned):.0f}° off odometry's way: is the lidar's mount turned by as much?",
        )
    yield (
        _still(compared),
        "odometry stands still while the scans move: are the encoders read, was it carried?",
    )
    for step in range(1, round(LATEST_S / LATE_STEP_S) + 1):
        late = round(step * LATE_STEP_S * 1e9)
        yield (
            lambda each, late=late: _late(each, trail, late),  # type: ignore[misc]
            f"scans come {step * LATE_STEP_S:.1f} s after odometry of the same stamp: are they delayed?",
        )


def _still(compared: list[Compared]) -> Callable[[Compared], Pose]:
    """The scans' motion, where odometry has none at all."""
    quiet = all(
        sum(distances2(IDENTITY, each.odometry, each.spread)) < 1.0 for each in compared if each.is_fault
    )
    return lambda each: (each.scans or IDENTITY) if quiet else each.odometry


def _turned(compared: list[Compared]) -> float:
    """Angle, rad, from odometry's way to the scans'."""
    dot = cross = 0.0
    for each in compared:
        if each.scans is not None:
            dot += each.odometry[0] * each.scans[0] + each.odometry[1] * each.scans[1]
            cross += each.odometry[0] * each.scans[1] - each.odometry[1] * each.scans[0]
    return wrap(atan2(cross, dot)) if dot or cross else 0.0


def _rotated(pose: Pose, angle: float) -> Pose:
    c, s = cos(angle), sin(angle)
    return c * pose[0] - s * pose[1], s * pose[0] + c * pose[1], pose[2]


def _late(each: Compared, trail: OdometryTrail, late: int) -> Pose:
    a, b = trail.at(each.since - late), trail.at(each.stamp - late)
    return motion(a, b).delta if a is not None and b is not None else each.odometry
