"""The dialect of zenoh-bridge-ros2dds, for a robot whose ROS 2 uses DDS.

A message's key is its topic, without an attachment. The bridge takes our liveliness tokens for those of
another bridge, so it shows the topics to ROS before the first message.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from eigenscan.ros_bridge.cdr import type_hash
from eigenscan.ros_bridge.endpoints import Endpoint, Qos, Role

_SLASH = "§"
_DEFAULT_DEPTH = 1


class Ros2Dds:
    """The keys of one robot. `session` is the Zenoh id of this side."""

    def __init__(self, session: str) -> None:
        self._session = session

    def key(self, endpoint: Endpoint) -> str:
        """`[<namespace>/]<topic>`."""
        return endpoint.name.strip("/")

    def tokens(self, endpoints: Iterable[Endpoint]) -> Iterator[str]:
        """One for the bridge, one for each endpoint."""
        bridge = f"@/{self._session}/@ros2_lv"
        yield bridge
        for endpoint in endpoints:
            key, kind = self.key(endpoint).replace("/", _SLASH), endpoint.kind.replace("/", _SLASH)
            token = f"{bridge}/{endpoint.role.value}/{key}/{kind}"
            is_topic = endpoint.role is not Role.SERVICE
            yield f"{token}/{qos_chunk(endpoint.qos, type_hash(endpoint.kind))}" if is_topic else token

    def attachment(self, _endpoint: Endpoint, _number: int, _time: int) -> None:
        """Nothing."""
        return

    def reply_attachment(self, _request: bytes, _time: int) -> None:
        """None: the bridge itself remembers the asker."""
        return


def qos_chunk(qos: Qos, kind_hash: str) -> str:
    """No key; reliability, durability, history and depth by DDS's numbers, unless they are DDS's defaults.

    Then user data, as ROS 2 writes it.
    """
    durability = "1" if qos.transient_local else ""
    history = "" if qos.depth == _DEFAULT_DEPTH else f"0,{qos.depth}"
    return f":{int(qos.reliable)}:{durability}:{history}:typehash={kind_hash};"
