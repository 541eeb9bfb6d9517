"""The paper's own tracking (section 7), to its formulas: sequences of poses, each with a probability.

It assumes that the robot is on the map and that one of the sequences is right: there is no mass for
"none of these". The mixture in `belief` is what goes beyond; both keep the same tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from eigenscan.tracker.association import associate
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.covariance import fuse, log_density, mahalanobis_squared, residual
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Tracks, begin, join
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.intp]

NEW_PROBABILITY = 1e-2
"""The default minimum probability of a sequence that a hypothesis starts."""
DECAY_S = 1.0
"""s in which a sequence without hypotheses loses 1 - 1/e of its probability."""


@dataclass
class Sequences(Belief):
    """The paper's tracks. Its threshold on p(Y|X) is the validation gate on the exponent."""

    seconds: float = 0.0
    """Since the last observation."""

    def predict(self, moved: Motion) -> None:
        """C*_{t+T} = C_t + W without odometry, odometry's own covariance with it."""
        self.seconds += max(moved.seconds, 0.0)
        if len(self.tracks):
            x, C = predict(self.tracks.x, self.tracks.C, moved, self.settings)
            self.tracks = replace(self.tracks, x=x, C=C)

    def observe(self, seen: Observation, share: Share) -> None:
        """Each hypothesis goes on with the track that makes it most probable, or starts one.

        A track without a hypothesis keeps its prediction, and fades. Then all p sum to 1.
        """
        del share  # the paper takes every scan as new
        frame = self.frame_index(seen.frame, seen.area)
        self.source_index(seen.source)
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
            for part in self.elsewhere:
                part.log_weight = -np.inf
        self.normalise()

    def _most_probable_track(self, old: Tracks, seen: Observation) -> Index:
        """Track of greatest p(Y_k|X_i) for each hypothesis (k,); -1 where none is within gate and reach."""
        pairs = associate(old.x, old.C, seen.poses, seen.covariances, self.gate)
        i, k = pairs.track, pairs.hypothesis
        # the maximum displacement rule, with room for what is not known of either
        unknown = old.C[i] + seen.covariances[k]
        sigma = np.sqrt(unknown[:, 0, 0] + unknown[:, 1, 1])
        distance = np.hypot(*(seen.poses[k] - old.x[i])[:, :2].T)
        allowed = distance <= self.settings.v_max * self.seconds + 3.0 * sigma
        i, k = i[allowed], k[allowed]
        density = log_density(residual(seen.poses[k], old.x[i]), unknown[allowed])
        order = np.argsort(density, kind="stable")
        best = np.full(len(seen.poses), -1, dtype=np.intp)
        best[k[order]] = i[order]  # the last, most probable one stands
        return best

    def _started(self, frame: int, seen: Observation, k: Index) -> Tracks:
        """New sequences of least probability; where there are none yet, as probable as their scans."""
        fit = seen.log_likelihoods[k]
        least = np.log(NEW_PROBABILITY) if len(self.tracks) else 0.0
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
    """Tracks fused with their hypotheses; one that has several forks."""
    k = np.flatnonzero(best >= 0)
    # of a track's hypotheses the likeliest goes on under its name
    k = k[np.lexsort((-seen.log_likelihoods[k], best[k]))]
    i = best[k]
    fork = np.zeros(len(i), dtype=bool)
    fork[1:] = i[1:] == i[:-1]
    tracks = old.pick(i)
    y, R = seen.poses[k], seen.covariances[k]
    innovation, expected = residual(y, tracks.x), tracks.C + R
    fit = seen.log_likelihoods[k] + log_density(innovation, expected)
    x, C = fuse(tracks.x, tracks.C, y, R)
    return replace(
        tracks,
        x=x,
        C=C,
        log_weight=tracks.log_weight + fit - fit.max(initial=-np.inf),
        id=np.where(fork, 0, tracks.id),
        parent=np.where(fork, tracks.id, tracks.parent),
        observations=tracks.observations + 1,
        nis=mahalanobis_squared(innovation, expected),
    )
