"""A channel for time: wakes a core that must act without messages.

It is not part of the contract and never leaves the process. The runtime sends it once a second to each core
that has it among its inputs. It is not recorded, so in a replay a core uses only the stamps of its messages.
"""

from __future__ import annotations

from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope, stamp
from google.protobuf.timestamp_pb2 import Timestamp

TICK = Channel("tick", "tick", Timestamp, about="a second has passed; the message is the time")
TICK_S = 1.0


def tick(nanoseconds: int) -> Envelope:
    """The tick at `nanoseconds` since the epoch."""
    return Envelope(TICK, {}, stamp(nanoseconds))
