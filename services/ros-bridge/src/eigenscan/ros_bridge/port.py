"""The bridge's endpoints in ROS 2, on its second Zenoh session."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

import zenoh
from eigenscan.ros_bridge.channels import ROS_ANSWERED, ROS_ASKED, ROS_PUBLISHED, ROS_RECEIVED
from eigenscan.ros_bridge.endpoints import Dialect, Endpoint, Role, endpoints
from eigenscan.ros_bridge.options import RosBridgeOptions
from eigenscan.ros_bridge.session import dialect_of, open_towards_ros, subscribe
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import encode, encoding
from google.protobuf.wrappers_pb2 import BytesValue

HEARTBEAT_S = 1.0
"""Interval of heartbeats on transient local topics, by which a subscriber notices a lost message, s."""
PATIENT_REQUESTS = 64
"""More than these at a time to one service are not waited for."""


class RosPort:
    """Publishes and receives ROS 2's endpoints in one dialect."""

    channels: tuple[Channel, ...] = (ROS_RECEIVED, ROS_PUBLISHED, ROS_ASKED, ROS_ANSWERED)

    def __init__(self, settings: RosBridgeOptions) -> None:
        self._settings = settings
        self._endpoints = list(endpoints(settings))
        self._publishers: dict[str, _Publisher] = {}
        self._services: dict[str, _Service] = {}
        self._declared: list[Any] = []
        self._session: zenoh.Session | None = None

    def open(self, inbox: Inbox) -> None:
        """Connects, declares all endpoints, then shows them in ROS 2's graph. Raises ContractError.

        Waits for a router that is on another machine.
        """
        session = self._session = open_towards_ros(self._settings)
        dialect = dialect_of(self._settings, session)
        for endpoint in self._endpoints:
            key = dialect.key(endpoint)
            if endpoint.role is Role.PUBLISHER:
                self._publishers[endpoint.chunk] = _Publisher(session, dialect, endpoint)
            elif endpoint.role is Role.SUBSCRIPTION:
                self._declared.append(subscribe(session, key, endpoint, _Intake(endpoint, inbox).on_sample))
            else:
                service = self._services[endpoint.chunk] = _Service(key, endpoint, inbox, dialect)
                self._declared.append(session.declare_queryable(key, service.on_query, complete=True))
        liveliness = session.liveliness()
        self._declared.extend(liveliness.declare_token(key) for key in dialect.tokens(self._endpoints))

    def publish(self, envelope: Envelope) -> None:
        """Publishes CDR bytes on the topic that the address names, or responds with them to the request."""
        data, endpoint = envelope.open(BytesValue).value, envelope.address["endpoint"]
        if envelope.channel is ROS_ANSWERED:
            self._services[endpoint].respond(int(envelope.address["number"]), data)
        else:
            self._publishers[endpoint].put(data)

    def close(self) -> None:
        """Takes the endpoints out of ROS 2's graph, the newest first, and closes the session."""
        declared: Iterable[Any] = [*reversed(self._declared), *self._publishers.values()]
        self._declared.clear()
        self._publishers.clear()
        for one in declared:
            with contextlib.suppress(zenoh.ZError):  # the link may be gone already
                one.undeclare()
        if self._session is not None:
            self._session.close()


class _Publisher:
    """One published topic; a late subscriber of a transient local one gets the last message."""

    def __init__(self, session: zenoh.Session, dialect: Dialect, endpoint: Endpoint) -> None:
        self._dialect, self._endpoint = dialect, endpoint
        self._number = 0
        key, qos = dialect.key(endpoint), endpoint.qos
        if qos.transient_local:
            self._publisher: Any = zenoh.ext.declare_advanced_publisher(
                session,
                key,
                cache=zenoh.ext.CacheConfig(qos.depth),
                publisher_detection=True,
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=HEARTBEAT_S
                ),
            )
        else:
            self._publisher = session.declare_publisher(key, express=True)

    def put(self, payload: bytes) -> None:
        self._number += 1
        beside = self._dialect.attachment(self._endpoint, self._number, time.time_ns())
        self._publisher.put(payload, attachment=beside)

    def undeclare(self) -> None:
        self._publisher.undeclare()


class _Intake:
    """Puts the messages of one endpoint into the inbox."""

    def __init__(self, endpoint: Endpoint, inbox: Inbox) -> None:
        self._key = ROS_RECEIVED.key({"endpoint": endpoint.chunk})
        self._inbox = inbox

    def put(self, data: bytes) -> None:
        self._inbox.put(ROS_RECEIVED, self._key, encode(BytesValue(value=data)), encoding(ROS_RECEIVED))

    def on_sample(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self.put(sample.payload.to_bytes())


class _Service:
    """Puts requests into the inbox and holds them until they are answered, the newest only."""

    def __init__(self, key: str, endpoint: Endpoint, inbox: Inbox, dialect: Dialect) -> None:
        self._key, self._endpoint, self._inbox, self._dialect = key, endpoint, inbox, dialect
        self._waiting: OrderedDict[int, zenoh.Query] = OrderedDict()
        self._number = 0
        self._lock = threading.Lock()

    def on_query(self, query: zenoh.Query) -> None:
        with self._lock:
            self._number += 1
            number = self._number
            self._waiting[number] = query
            if len(self._waiting) > PATIENT_REQUESTS:
                self._waiting.popitem(last=False)[1].drop()
        key = ROS_ASKED.key({"endpoint": self._endpoint.chunk, "number": str(number)})
        request = query.payload.to_bytes() if query.payload else b""
        self._inbox.put(ROS_ASKED, key, encode(BytesValue(value=request)), encoding(ROS_ASKED))

    def respond(self, number: int, response: bytes) -> None:
        with self._lock:
            query = self._waiting.pop(number, None)
        if query is None:
            return
        beside = query.attachment.to_bytes() if query.attachment else b""
        with query, contextlib.suppress(zenoh.ZError):  # the asker is gone
            if response:
                attachment = self._dialect.reply_attachment(beside, time.time_ns())
                query.reply(self._key, response, attachment=attachment)
