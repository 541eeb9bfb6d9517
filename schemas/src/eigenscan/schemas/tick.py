"""Time as a channel: for a core that must act now and then, also without messages.

It is not of the contract and never leaves its process: the runtime says it, once a second, to a core that
receives it. As it is not recorded, a core that is replayed goes by the stamps of its messages instead.
"""

from __future__ import annotations

from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope, stamp
from google.protobuf.timestamp_pb2 import Timestamp

TICK = Channel("tick", "tick", Timestamp, about="a second has passed; the message is the time")
TICK_S = 1.0


def tick(nanoseconds: int) -> Envelope:
    """It is `nanoseconds` since the epoch."""
    return Envelope(TICK, {}, stamp(nanoseconds))
