"""One projector's answer to one scan, checked and in arrays."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, Hypotheses
from eigenscan.tracker.covariance import is_covariance
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import WEIGHTS
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOG_LIKELIHOOD_LIMIT = 300.0
"""Evidence beyond this is an overflow of somebody's arithmetic, not knowledge."""
FARTHEST = 1e7
"""m from the map's origin: beyond it a number is an overflow, not a place."""
SIGMA_LIMITS = np.array([[0.005, 10.0], [0.005, 10.0], [0.002, np.pi]])
"""m, m, rad: no scan fixes a pose better than the lower; the upper means nothing is known."""

GOOD, POORER = 12.0, 0.25
"""Log-likelihood from which on a pose errs as its covariance states; nats of the factor on it for each less.

Rounded from intel and guardian 3 on worse maps, and alike on fr079: benchmarks/evidence.py --way.
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
    finite = np.isfinite(rows[:, :4]).all(axis=1) & (np.abs(rows[:, :2]) < FARTHEST).all(axis=1)
    if not finite.all():
        counts["hypothesis_not_finite"] += int((~finite).sum())
        rows = rows[finite]
    covariances = rows[:, [4, 5, 6, 5, 7, 8, 6, 8, 9]].reshape(-1, 3, 3)
    likelihoods = settings.trust * rows[:, 3].clip(-LOG_LIKELIHOOD_LIMIT, LOG_LIKELIHOOD_LIMIT)
    good = is_covariance(covariances)
    if not good.all():
        counts["covariance_replaced"] += int((~good).sum())
        sigma = np.array([settings.grid_spacing, settings.grid_spacing, settings.grid_step])
        covariances = np.where(good[:, None, None], covariances, np.diag(sigma**2))
    if settings.method != "paper":
        covariances = covariances * np.exp(poorness(likelihoods))[:, None, None]
    unlisted = message.unlisted_log_likelihood
    unlisted = (
        float(np.clip(unlisted, -LOG_LIKELIHOOD_LIMIT, LOG_LIKELIHOOD_LIMIT))
        if np.isfinite(unlisted)
        else 0.0
    )
    return Observation(
        nanoseconds(message.timestamp),
        f"{address['lidar']}/{address['projector']}",
        address["lidar"],
        message.frame_id,
        np.column_stack([rows[:, :2], wrap(rows[:, 2])]),
        limit_sigma(covariances),
        likelihoods,
        settings.trust * unlisted,
        message.searched_area_m2 if 1.0 <= message.searched_area_m2 < 1e9 else 1.0,
        message.status != Hypotheses.STATUS_UNUSABLE_SCAN,
        message.model_version,
        len(message.hypotheses),
        message.search == SEARCH_LOCAL,
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


def _rows(message: Hypotheses) -> Array:
    """x, y, theta, log-likelihood and the covariance's upper triangle of each hypothesis, (k, 10)."""
    numbers = list[float]()
    for hypothesis in message.hypotheses:
        pose, c = hypothesis.pose, hypothesis.covariance
        numbers += [pose.x, pose.y, pose.theta, hypothesis.log_likelihood]
        numbers += [c.xx, c.xy, c.xt, c.yy, c.yt, c.tt]
    return np.array(numbers).reshape(-1, 10)


def limit_sigma(covariances: Array) -> Array:
    """Covariances (k, 3, 3) with each axis' sigma within SIGMA_LIMITS, correlations kept."""
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    scale = sigma.clip(SIGMA_LIMITS[:, 0], SIGMA_LIMITS[:, 1]) / sigma
    scaled: Array = covariances * scale[:, :, None] * scale[:, None, :]
    # keeps nearly singular ones well away from the edge
    return scaled + np.eye(3) * (0.05 * SIGMA_LIMITS[:, 0]) ** 2
