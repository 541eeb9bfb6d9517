"""The dialect of rmw_zenoh (its design document).

A message's key holds domain, topic, type and the type's hash. Beside it travel its number, the time and the
publisher's id. Every node and endpoint has a liveliness token, from which that id is made.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator

import xxhash
from eigenscan.ros_bridge.cdr import dds_name, type_hash
from eigenscan.ros_bridge.endpoints import NODE, Endpoint, Qos

_ATTACHMENT = struct.Struct("<qqB16s")  # number, ns, length of the id, id
_ID_LENGTH = 16
_DEFAULT_DEPTH = 42
_NO_HASH = "TypeHashNotSupported"
"""The hash in ROS 2 Humble, which has none."""


class RmwZenoh:
    """The bridge's ROS nodes on one Zenoh session (`session`: its id)."""

    def __init__(self, domain: int, namespace: str, session: str, *, hashed: bool = True) -> None:
        self._domain, self._namespace, self._session = domain, namespace, session
        self._hashed = hashed
        self._ids: dict[str, int] = {NODE: 0}  # of nodes and endpoints
        self._gids: dict[str, bytes] = {}

    def key(self, endpoint: Endpoint) -> str:
        """`<domain>/<topic>/<type in DDS>/<type's hash>`."""
        return f"{self._domain}/{endpoint.name.strip('/')}/{self._type(endpoint.kind)}"

    def tokens(self, endpoints: Iterable[Endpoint]) -> Iterator[str]:
        """One for each node, one for each endpoint."""
        endpoints = list(endpoints)
        for node in dict.fromkeys([NODE, *(endpoint.node for endpoint in endpoints)]):
            yield self._token(node, node, "NN")
        for endpoint in endpoints:
            yield self._endpoint_token(endpoint)

    def attachment(self, endpoint: Endpoint, number: int, time: int) -> bytes:
        """33 bytes."""
        gid = self._gids.get(endpoint.chunk + endpoint.role.value)
        if gid is None:
            gid = self._gids[endpoint.chunk + endpoint.role.value] = gid_of(self._endpoint_token(endpoint))
        return _ATTACHMENT.pack(number, time, _ID_LENGTH, gid)

    def reply_attachment(self, request: bytes, time: int) -> bytes | None:
        """The request's number and its client's id, by which the client knows its reply."""
        if len(request) != _ATTACHMENT.size:
            return None
        number, _, length, gid = _ATTACHMENT.unpack(request)
        return _ATTACHMENT.pack(number, time, length, gid)

    def _endpoint_token(self, endpoint: Endpoint) -> str:
        about = f"{endpoint.chunk}/{self._type(endpoint.kind)}/{qos_chunk(endpoint.qos)}"
        own = self._token(endpoint.node, endpoint.chunk + endpoint.role.value, endpoint.role.value)
        return f"{own}/{about}"

    def _type(self, kind: str) -> str:
        return f"{dds_name(kind)}/{type_hash(kind) if self._hashed else _NO_HASH}"

    def _token(self, node: str, entity: str, kind: str) -> str:
        numbers = f"{self._number(node)}/{self._number(entity)}"
        namespace = ("/" + self._namespace.strip("/")).replace("/", "%")
        return f"@ros2_lv/{self._domain}/{self._session}/{numbers}/{kind}/%/{namespace}/{node}"

    def _number(self, entity: str) -> int:
        return self._ids.setdefault(entity, len(self._ids))


def qos_chunk(qos: Qos) -> str:
    """Reliability, durability, history, deadline, lifespan, liveliness; empty: rmw_zenoh's default."""
    reliability = "" if qos.reliable else "2"
    durability = "1" if qos.transient_local else ""
    depth = "" if qos.depth == _DEFAULT_DEPTH else str(qos.depth)
    return f"{reliability}:{durability}:,{depth}:,:,:,,"


def gid_of(token: str) -> bytes:
    """The 16 bytes by which an endpoint is known: XXH3 of its token, low half first."""
    return xxhash.xxh3_128_intdigest(token.encode()).to_bytes(_ID_LENGTH, "little")
