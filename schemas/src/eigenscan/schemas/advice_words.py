"""Advice in plain words, for people who watch a robot."""

from __future__ import annotations

from math import degrees, isfinite, remainder, tau

from eigenscan.schemas.advice_pb2 import Advice

AHEAD_DEG, BACK_DEG = 10.0, 170.0
"""Headings that are as good as straight ahead, and straight back."""
HOLDS_S = 3.0
"""Age of advice, s, from which it is not shown any more: it comes once a second."""


def words_of(advice: Advice) -> str:
    """Such as `drive 3.2 m, 40° to the left, to distinguish 2 places`; empty for what is no advice."""
    count = len(advice.track_ids)
    places = f"{count} places" if count > 1 else "the places"
    if advice.kind == Advice.KIND_NOTHING and isfinite(advice.reach):
        return f"no move within {advice.reach:.0f} m distinguishes {places}"
    if advice.kind != Advice.KIND_MOVE or not (isfinite(advice.heading) and isfinite(advice.distance)):
        return ""
    turn = degrees(remainder(advice.heading, tau))
    side = f"{abs(turn):.0f}° to the {'left' if turn > 0 else 'right'}"
    if advice.distance <= 0.0:
        return f"turn {side} to distinguish {places}"
    if abs(turn) > BACK_DEG:
        side = "straight back"
    elif abs(turn) < AHEAD_DEG:
        side = "straight ahead"
    return f"drive {advice.distance:.1f} m, {side}, to distinguish {places}"
