"""Panoramas and the scans that are windows of them (paper, section 3).

A panorama (N,) holds the range along each world direction k 2 pi / N. A sensor of the same angular step
that stands there sees a window of it: beam j of the window k is panorama[(k + j) mod N], and the sensor's
heading is k 2 pi / N - angle_min. So one panorama is N scans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.circle import TURN, wrap
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sensor:
    """Angular grid of a scan: beam j looks along angle_min + j * angle_increment, rad, from its heading.

    `range_max` in m; 0 = not limited.
    """

    angle_min: float
    angle_increment: float
    beams: int
    range_max: float = 0.0

    @classmethod
    def facing(cls, field_of_view: float, step: float, range_max: float = 0.0) -> Sensor:
        """Sensor with its field of view (rad) centred ahead; the last beam of a full turn is left out."""
        steps = round(field_of_view / step)
        beams = min(steps + 1, round(TURN / step))
        return cls(-0.5 * step * steps, step, beams, range_max)

    @property
    def turn(self) -> int:
        """Beams of a full turn at this step, rounded: the N of the panoramas that fit."""
        return round(TURN / self.angle_increment)

    def headings(self, turn: int) -> NDArray[np.float64]:
        """Heading (N,) of the sensor for each window of a panorama of N = `turn` beams, in [-pi, pi)."""
        return wrap(np.arange(turn) * (TURN / turn) - self.angle_min)


def resample(panoramas: NDArray[np.float32], turn: int) -> NDArray[np.float32]:
    """Panoramas (..., N) at another angular step, (..., turn).

    Between two beams 1 / r is interpolated, which is exact to second order on a straight wall. If they see
    different walls (or one of them none) the nearer beam in angle counts.
    """
    have = panoramas.shape[-1]
    if turn == have:
        return panoramas
    place = np.arange(turn) * (have / turn)
    low = np.floor(place).astype(np.int64)
    share = (place - low).astype(np.float32)
    before, after = panoramas[..., low], panoramas[..., (low + 1) % have]
    nearest = np.where(share < 0.5, before, after)
    with np.errstate(divide="ignore", invalid="ignore"):
        blend = 1.0 / ((1.0 - share) / before + share / after)
        # a straight wall seen at more than 6 degrees changes by less than this from beam to beam
        same = np.abs(after - before) < _SLANT * (TURN / have) * np.minimum(before, after)
    mixed: NDArray[np.float32] = np.where(same & (share > 0), blend, nearest).astype(np.float32)
    return mixed


_SLANT = 10.0
"""Cotangent of the flattest angle at which two neighbouring beams still count as on one wall."""
