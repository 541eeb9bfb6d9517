"""The paper's own tracking (section 7), step by step: sequences of poses, each a Kalman filter of filterpy's.

For reading and comparing: it assumes that the robot is on the map and that one of the sequences is right, so
there is no mass for "none of these", and it takes every scan as new evidence. The mixture in `belief` is what
goes beyond. Filters are made again for each step, of the tracks that both keep.

Where the paper leaves a choice, or states what cannot hold, this does:
- A sequence's probability is the product of its p(Y|X) and of its hypotheses' own likelihoods.
- p(Y|X) is under C* + C, the covariance of Y - X: under the printed C* alone no pose belongs to a track any
  more once the track is surer than a single pose.
- A track that forks has no more probability than one that does not: its forks share it, by p(Y|X).
- The default minimum probability is shared by all sequences that one scan begins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import compose
from eigenscan.schemas.extra import needs
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.covariance import log_density, mahalanobis_squared, residual
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import motion_noise
from eigenscan.tracker.reckoning import Leg, Motions
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Tracks, begin, join
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

NEW_PROBABILITY = 1e-2
"""The default minimum probability: of all sequences together that the hypotheses of one scan start."""
DECAY_S = 1.0
"""s in which a sequence without hypotheses loses 1 - 1/e of its probability."""


@dataclass
class Sequences(Belief):
    """The paper's tracks."""

    seconds: float = 0.0
    """Since the last observation."""

    def predict(self, moved: Motion) -> None:
        """C*_{t+T} = C_t + W: W = T^2 v_max^2 without odometry, odometry's own covariance with it."""
        self.seconds += max(moved.seconds, 0.0)
        W = np.diag(motion_noise(moved, self.settings))
        x, C = self.tracks.x.copy(), self.tracks.C.copy()
        kalman = _filter()
        for i in range(len(x)):
            kalman.x, kalman.P = x[i], C[i]
            F, G = _derivatives(x[i], np.array(moved.delta))
            kalman.predict(F=F, Q=G @ W @ G.T)
            # poses are no vectors: the state moves as poses do, the covariance by the derivatives
            x[i], C[i] = compose(x[i], np.array(moved.delta)), kalman.P
        self.tracks = replace(self.tracks, x=x, C=C)

    def correct(self, way: Leg, now: int, motions: Motions) -> None:
        """Leaves the tracks as odometry alone has predicted them, as the paper does."""

    def observe(self, seen: Observation, share: Share) -> None:
        """Each hypothesis goes on with the track that makes it most probable, or starts one.

        A track without a hypothesis keeps its prediction, and fades. Then all p sum to 1.
        """
        del share  # the paper takes every scan as new
        frame = self.frame_index(seen.frame, seen.area)
        self.source_index(seen.source)
        seen = replace(seen, covariances=np.tile(self._grid_covariance(), (len(seen.poses), 1, 1)))
        mine = self.tracks.frame == frame
        old = self.tracks.pick(mine)
        best = self._most_probable_track(old, seen)
        alone = old.pick(np.setdiff1d(np.arange(len(old)), best[best >= 0]))
        self.tracks = join(
            [
                self.tracks.pick(~mine),
                _continued(old, seen, best),
                replace(alone, log_weight=alone.log_weight - self.seconds / DECAY_S),
                self._started(frame, seen, np.flatnonzero(best < 0)),
            ]
        )
        self.seconds = 0.0
        if len(self.tracks):
            # the robot is assumed to be inside the grid area
            self.elsewhere.log_weight[:] = -np.inf
        self.normalise()

    def _grid_covariance(self) -> Array:
        """Cp (3, 3): the grid sample sizes are the standard deviations of a pose estimate."""
        spacing, step = self.settings.grid_spacing, self.settings.grid_step
        return np.diag(np.array([spacing, spacing, step]) ** 2)

    def _most_probable_track(self, old: Tracks, seen: Observation) -> Index:
        """Track of greatest p(Y_k|X_i) for each hypothesis (k,); -1 where none is within gate and reach."""
        if not len(old) or not len(seen.poses):
            return np.full(len(seen.poses), -1, dtype=np.intp)
        innovation = residual(seen.poses[:, None], old.x[None])
        unknown = old.C[None] + seen.covariances[:, None]
        # the threshold on p(Y|X), as a gate on its exponent
        near = mahalanobis_squared(innovation, unknown) <= self.gate
        # the maximum displacement rule, with room for what is not known of either
        sigma = np.sqrt(unknown[..., 0, 0] + unknown[..., 1, 1])
        way = np.hypot(innovation[..., 0], innovation[..., 1])
        near &= way <= self.settings.v_max * self.seconds + 3.0 * sigma
        density = np.where(near, log_density(innovation, unknown), -np.inf)
        return np.where(near.any(axis=1), density.argmax(axis=1), -1)

    def _started(self, frame: int, seen: Observation, k: Index) -> Tracks:
        """New sequences of least probability; where there are none yet, as probable as their scans."""
        fit = seen.log_likelihoods[k]
        least = np.log(NEW_PROBABILITY / max(len(k), 1)) if len(self.tracks) else 0.0
        return begin(
            seen.poses[k],
            seen.covariances[k],
            least + fit - fit.max(initial=-np.inf),
            np.zeros(len(k)),
            np.zeros((len(k), len(self.sources))),
            frame,
            seen.stamp,
        )


def _continued(old: Tracks, seen: Observation, best: Index) -> Tracks:
    """Tracks updated by their hypotheses, C^ = (C*^-1 + C^-1)^-1; one that has several forks."""
    k = np.flatnonzero(best >= 0)
    # of a track's hypotheses the likeliest goes on under its name
    k = k[np.lexsort((-seen.log_likelihoods[k], best[k]))]
    i = best[k]
    fork = np.zeros(len(i), dtype=bool)
    fork[1:] = i[1:] == i[:-1]
    tracks = old.pick(i)
    y, R = seen.poses[k], seen.covariances[k]
    innovation, unknown = residual(y, tracks.x), tracks.C + R
    fit = seen.log_likelihoods[k] + log_density(innovation, unknown)
    x, C = tracks.x.copy(), tracks.C.copy()
    kalman = _filter()
    for row in range(len(k)):
        kalman.x, kalman.P = x[row], C[row]
        kalman.update(x[row] + innovation[row], R=R[row])  # the heading that is the shortest turn away
        x[row], C[row] = kalman.x, kalman.P
    x[:, 2] = wrap(x[:, 2])
    best_of, sum_of = np.full(len(old), -np.inf), np.full(len(old), -np.inf)
    np.maximum.at(best_of, i, fit)
    np.logaddexp.at(sum_of, i, fit)
    # how many volumes of one place hold the scan is no evidence: forks share what their best one gained
    gained = best_of[i] - fit.max(initial=-np.inf) + fit - sum_of[i]
    return replace(
        tracks,
        x=x,
        C=C,
        log_weight=tracks.log_weight + gained,
        id=np.where(fork, 0, tracks.id),
        parent=np.where(fork, tracks.id, tracks.parent),
        observations=tracks.observations + 1,
        nis=mahalanobis_squared(innovation, unknown),
    )


def _filter() -> Any:
    """A Kalman filter of filterpy's for a pose that is observed whole; x (3,) and P (3, 3) are to be set."""
    with needs("eigenscan-tracker[paper]"):
        from filterpy.kalman import KalmanFilter  # a second to import, and only this method needs it

    kalman = KalmanFilter(dim_x=3, dim_z=3)
    kalman.H = np.eye(3)
    return kalman


def _derivatives(x: Array, delta: Array) -> tuple[Array, Array]:
    """Of a pose moved by an increment in its own frame: by the pose before, and by the increment, (3, 3)."""
    c, s = np.cos(x[2]), np.sin(x[2])
    F, G = np.eye(3), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    F[0, 2], F[1, 2] = -s * delta[0] - c * delta[1], c * delta[0] - s * delta[1]
    return F, G
