"""How ROS 2's topics are told on Zenoh: there are two ways, and a robot speaks one of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from eigenscan.ros_bridge.endpoints import Endpoint


class Dialect(Protocol):
    """Keys, liveliness tokens and attachments of one way."""

    def key(self, endpoint: Endpoint) -> str:
        """Key of its messages, or of its queries."""
        ...

    def tokens(self, endpoints: Iterable[Endpoint]) -> Iterator[str]:
        """Keys of the liveliness tokens by which ROS 2's graph knows of the endpoints."""
        ...

    def attachment(self, endpoint: Endpoint, number: int, time: int) -> bytes | None:
        """What travels beside the message number `number`, counted from 1, said at `time` (ns)."""
        ...

    def reply_attachment(self, request: bytes, time: int) -> bytes | None:
        """What travels beside the reply to a service's request that had `request` beside it."""
        ...
