"""The colours of the picture: one meaning each, distinguished also by the colour-blind (Okabe and Ito)."""

from __future__ import annotations

import numpy as np
from eigenscan.schemas.tracking_pb2 import (
    STATE_AMBIGUOUS,
    STATE_LOCALIZED,
    STATE_LOST,
    STATE_UNSPECIFIED,
)
from eigenscan.schemas.words import state_word
from numpy.typing import ArrayLike, NDArray

Colour = tuple[int, int, int]

LOCALIZED: Colour = (0, 140, 90)
AMBIGUOUS: Colour = (215, 130, 0)
LOST: Colour = (200, 40, 30)
SILENT: Colour = (110, 110, 110)

SCAN: Colour = (0, 90, 200)
OBSTACLE: Colour = (230, 30, 30)
HYPOTHESIS: Colour = (240, 140, 0)
UNLIKELY: Colour = (195, 195, 195)
TRACK: Colour = (125, 60, 180)
ADVICE: Colour = (0, 150, 170)
TRUTH: Colour = (20, 20, 20)
REGION: Colour = (120, 160, 190)
PLACE: Colour = (196, 208, 218)

STATE_COLOURS = {
    STATE_LOCALIZED: LOCALIZED,
    STATE_AMBIGUOUS: AMBIGUOUS,
    STATE_LOST: LOST,
    STATE_UNSPECIFIED: SILENT,
}


def state_name(state: int) -> str:
    """Name of a state for operators, such as LOCALIZED; UNKNOWN for other numbers."""
    return state_word(state).upper()


def blend(low: Colour, high: Colour, share: ArrayLike) -> NDArray[np.uint8]:
    """Colours (n, 3) between `low` at share 0 and `high` at share 1."""
    t = np.clip(np.asarray(share, dtype=np.float64), 0.0, 1.0)[:, None]
    colours: NDArray[np.uint8] = np.rint(np.array(low) * (1 - t) + np.array(high) * t).astype(np.uint8)
    return colours


def percent(confidence: float, step: int = 1) -> int:
    """A confidence in percent, rounded down to a step: the picture states no more. NaN: 0."""
    return step * int(100.0 * min(max(0.0, confidence), 1.0) / step + 1e-9)
