"""States and statuses in words; a later version of the contract may have more of them."""

from __future__ import annotations

from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tracking_pb2 import STATE_UNSPECIFIED, State

UNKNOWN = "unknown"


def state_word(state: int) -> str:
    """`localized`, `ambiguous` or `lost`; `unknown` for any other number."""
    if state == STATE_UNSPECIFIED or state not in State.values():
        return UNKNOWN
    return State.Name(state).removeprefix("STATE_").lower()


def status_word(status: int) -> str:
    """`ok`, `waiting` or `degraded`; `unknown` for any other number."""
    if status == Health.STATUS_UNSPECIFIED or status not in Health.Status.values():
        return UNKNOWN
    return Health.Status.Name(status).removeprefix("STATUS_").lower()
