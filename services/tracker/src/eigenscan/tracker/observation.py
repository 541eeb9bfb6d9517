"""One projector's answer to one scan, checked and in arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import hypot, isfinite
from operator import attrgetter

import numpy as np
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.pose import FARTHEST_M
from eigenscan.geometry.surfaces import POINT_SIGMA, THICKEST_M
from eigenscan.geometry.symmetric import MATRICES, put
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, Hypotheses
from eigenscan.tracker.range_errors import RangeError, gains
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import WEIGHTS, is_covariance_each, wrapped
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOG_LIKELIHOOD_LIMIT = 300.0
"""Evidence beyond this is an overflow of somebody's arithmetic, not knowledge."""
SIGMA_LIMITS = np.array([[0.005, 10.0], [0.005, 10.0], [0.002, np.pi]])
"""m, m, rad: no scan fixes a pose better than the lower; the upper means nothing is known."""

GOOD, POORER = 12.0, 0.25
"""Log-likelihood from which on a pose errs as its covariance states; nats of the factor on it for each less.

Rounded from intel and guardian 3 on worse maps, and alike on fr079: benchmarks/evidence.py --way.
"""


ALL_AROUND = 162
"""Of the 180 beams of a full turn, 2 degrees apart, from which on a scan shows the place in all directions: a
beam in ten may find nothing within reach.
"""


@dataclass(frozen=True)
class Observation:
    """Hypotheses (k) of one scan. Likelihoods are relative to a place that the map does not show."""

    stamp: int
    source: str
    """Key of the projector that published it: one chain of evidence."""
    lidar: str
    frame: str
    poses: Array
    covariances: Array
    log_likelihoods: Array
    unlisted: float
    """Log-likelihood of any pose in the map that is not listed."""
    area: float
    """m^2 that the search covered."""
    usable: bool
    model_version: str = ""
    listed: int = 0
    """Hypotheses in the message, also those that are no numbers."""
    local: bool = False
    """Whether only the place around the tracker's own pose was looked at."""
    surfaces: int = 0
    """Which surfaces of thick walls the poses fit."""
    unseen: float = TURN
    """rad of the place's surroundings that the scan does not show: turning by as much shows all of them."""
    range_gains: Mapping[RangeError, float] | None = None
    """Nats by which the scan is likelier if its ranges have such an error; None: not checked."""
    cut: bool = False
    """Whether places as likely as the last one may be missing."""
    inexactness: float = 0.0
    """m, how far the map's surfaces may be from where it draws them: standard deviation."""
    gathered: float = 0.0
    """m, over which scans share what they show, because each was put together of many sweeps."""

    @property
    def alike(self) -> float:
        """How much farther a robot comes than on an exact map until a scan is new evidence.

        By as much as surfaces are farther off than a lidar errs: along a wall they are off alike. On 15 worse
        maps, all looked at, 359 claims are false, not 1,045, and of 148 windows 126 succeed, not 127
        (benchmarks/mechanisms.py --way "thick, coarse, warped" --without "errors of a map that are alike").
        """
        return hypot(POINT_SIGMA, self.inexactness) / POINT_SIGMA

    def likelier_than_unlisted(self) -> Observation:
        """The same without hypotheses that are no likelier than a pose outside the list."""
        keep = self.log_likelihoods > self.unlisted + 1e-9
        if keep.all():
            return self
        return replace(
            self,
            poses=self.poses[keep],
            covariances=self.covariances[keep],
            log_likelihoods=self.log_likelihoods[keep],
        )


def observe(
    message: Hypotheses, address: Mapping[str, str], settings: TrackerSettings, counts: Counter[str]
) -> Observation:
    """Observation of a message; hypotheses that are no poses are left out and counted.

    One whose covariance is missing or not positive definite gets Cp, from the grid's spacing.
    """
    rows = _rows(message)
    poorer = POORER if settings.method != "paper" else 0.0
    poses, covariances, likelihoods, replaced = checked(
        rows, settings.trust, poorer, settings.grid_spacing, settings.grid_step
    )
    if len(poses) < len(rows):
        counts["hypothesis_not_finite"] += len(rows) - len(poses)
    if replaced:
        counts["covariance_replaced"] += replaced
    unlisted = message.unlisted_log_likelihood
    unlisted = min(max(unlisted, -LOG_LIKELIHOOD_LIMIT), LOG_LIKELIHOOD_LIMIT) if isfinite(unlisted) else 0.0
    return Observation(
        nanoseconds(message.timestamp),
        f"{address['lidar']}/{address['projector']}",
        address["lidar"],
        message.frame_id,
        poses,
        covariances,
        likelihoods,
        settings.trust * unlisted,
        message.searched_area_m2 if 1.0 <= message.searched_area_m2 < 1e9 else 1.0,
        message.status != Hypotheses.STATUS_UNUSABLE_SCAN,
        message.model_version,
        len(rows),
        message.search == SEARCH_LOCAL,
        message.surfaces,
        TURN * max(0.0, 1.0 - message.used_beams / ALL_AROUND),
        gains(message.range_check) if message.HasField("range_check") else None,
        message.cut,
        message.inexactness if 0.0 <= message.inexactness <= THICKEST_M else 0.0,
        message.gathered if 0.0 <= message.gathered < FARTHEST_M else 0.0,
    )


def poorness(log_likelihoods: Array) -> Array:
    """Ln of the factor (k,) >= 1 on the covariances (k, 3, 3) of hypotheses with these likelihoods (k,).

    A pose that explains little of the scan is more often the nearest fit than the place.
    """
    result: Array = poorness_each(log_likelihoods, POORER)
    return result


@njit(types.float64[::1](WEIGHTS, types.float64), cache=True)  # pragma: no cover - compiled
def poorness_each(log_likelihoods: Array, poorer: float) -> Array:
    """The same, compiled."""
    return poorer * np.minimum(np.maximum(GOOD - log_likelihoods, 0.0), GOOD)


_POSE, _UPPER = attrgetter("x", "y", "theta"), attrgetter("xx", "xy", "xt", "yy", "yt", "tt")


def _rows(message: Hypotheses) -> Array:
    """x, y, theta, log-likelihood and the covariance's upper triangle of each hypothesis, (k, 10)."""
    numbers = list[float]()
    for hypothesis in message.hypotheses:
        numbers += _POSE(hypothesis.pose)
        numbers.append(hypothesis.log_likelihood)
        numbers += _UPPER(hypothesis.covariance)
    return np.array(numbers).reshape(-1, 10)


def limit_sigma(covariances: Array) -> Array:
    """Covariances (k, 3, 3) with each axis' sigma within SIGMA_LIMITS, correlations kept."""
    result: Array = _limited(covariances)
    return result


@njit(types.float64[:, :, ::1](MATRICES), cache=True)  # pragma: no cover - compiled
def _limited(covariances: Array) -> Array:
    out, scale = np.empty((len(covariances), 3, 3)), np.empty(3)
    for k in range(len(out)):
        for axis in range(3):
            sigma = np.sqrt(covariances[k, axis, axis])
            scale[axis] = min(max(sigma, SIGMA_LIMITS[axis, 0]), SIGMA_LIMITS[axis, 1]) / sigma
        for row in range(3):
            for column in range(3):
                out[k, row, column] = covariances[k, row, column] * scale[row] * scale[column]
            # keeps nearly singular ones well away from the edge
            out[k, row, row] += (0.05 * SIGMA_LIMITS[row, 0]) ** 2
    return out


_NUMBERS, _TABLE, _NUMBER = types.float64[::1], types.float64[:, ::1], types.float64
_CHECKED = types.Tuple((_TABLE, types.float64[:, :, ::1], _NUMBERS, types.int64))


@njit(  # pragma: no cover - compiled
    _CHECKED(_TABLE, _NUMBER, _NUMBER, _NUMBER, _NUMBER), cache=True
)
def checked(
    rows: Array, trust: float, poorer: float, spacing: float, step: float
) -> tuple[Array, Array, Array, int]:
    """Poses (k, 3), covariances (k, 3, 3) and log-likelihoods (k,) of those `rows` (n, 10) that are poses.

    Then of how many the covariance had to be replaced by that of a grid of this spacing, m, and step, rad.
    """
    kept = np.zeros(len(rows), dtype=np.bool_)
    for row in range(len(rows)):
        x, y, theta, likelihood = rows[row, 0], rows[row, 1], rows[row, 2], rows[row, 3]
        is_place = abs(x) < FARTHEST_M and abs(y) < FARTHEST_M
        kept[row] = is_place and np.isfinite(theta) and np.isfinite(likelihood)
    rows = rows[kept]
    poses, covariances = rows[:, :3].copy(), np.empty((len(rows), 3, 3))
    likelihoods = trust * np.minimum(np.maximum(rows[:, 3], -LOG_LIKELIHOOD_LIMIT), LOG_LIKELIHOOD_LIMIT)
    for k in range(len(rows)):
        poses[k, 2] = wrapped(poses[k, 2])
        c = rows[k, 4:]
        put((c[0], c[1], c[2], c[3], c[4], c[5]), covariances[k])
    good, factor = is_covariance_each(covariances), np.exp(poorness_each(likelihoods, poorer))
    for k in range(len(rows)):
        if not good[k]:
            put((spacing * spacing, 0.0, 0.0, spacing * spacing, 0.0, step * step), covariances[k])
        for row in range(3):
            for column in range(3):
                covariances[k, row, column] *= factor[k]
    return poses, _limited(covariances), likelihoods, len(good) - good.sum()
