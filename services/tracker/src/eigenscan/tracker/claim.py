"""The pose that is claimed, carried by odometry: a claim that goes elsewhere is withdrawn first."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.symmetric import MATRICES, inverse, plus, square, triangle
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, STATE_LOCALIZED, State
from eigenscan.tracker.association import gate
from eigenscan.tracker.evidence import NEAR_M, NEAR_RAD
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import ROWS, apart
from eigenscan.tracker.tracks import Tracks
from numba import njit, types
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Claim:
    """The last claim of one robot, and how long another place has been the best since one was withdrawn."""

    def __init__(self, settings: TrackerSettings) -> None:
        self._settings = settings
        self._gate = gate(settings.gate_probability)
        self._x, self._C, self._frame = np.zeros((0, 3)), np.zeros((0, 3, 3)), 0
        self._held = np.inf

    def predict(self, moved: Motion) -> None:
        """Carries the claim by odometry."""
        if len(self._x):
            self._x, self._C = predict(self._x, self._C, moved, self._settings)

    def advance(self, seconds: float, progress: float) -> None:
        """Counts what was driven, 1: a scan is new evidence; or the time."""
        self._held += max(progress, seconds / self._settings.memory)

    def forget(self) -> None:
        """Scans show that the robot was carried away: what comes next is no jump."""
        self._x = self._x[:0]

    def held_back(self, state: State, tracks: Tracks, best: int) -> State:
        """The state, ambiguous instead of localized where the claim jumps, until it has held.

        That is for a step's way, or for the tracker's `memory`. A pose jumps that is neither at the claimed
        place nor where odometry may have carried the claim.
        """
        if state != STATE_LOCALIZED:
            self.forget()
            return state
        x, C, frame = tracks.x[best][None], tracks.C[best][None], int(tracks.frame[best])
        if len(self._x) and (frame != self._frame or self._is_apart(x, C)):
            self._held = 0.0
        self._x, self._C, self._frame = x, C, frame
        return STATE_LOCALIZED if self._held >= 1.0 else STATE_AMBIGUOUS

    def _is_apart(self, x: Array, C: Array) -> bool:
        return bool(_are_apart(x, C, self._x, self._C, self._gate))


@njit(types.boolean(ROWS, MATRICES, ROWS, MATRICES, types.float64), cache=True)  # pragma: no cover - compiled
def _are_apart(x: Array, C: Array, y: Array, R: Array, gate: float) -> bool:
    """Whether two poses (1, 3) are neither near each other nor within the gate of their covariances."""
    off = apart(x[0], y[0])
    if np.hypot(off[0], off[1]) <= NEAR_M and abs(off[2]) <= NEAR_RAD:
        return False
    return square(inverse(plus(triangle(R[0]), triangle(C[0]))), off) > gate
