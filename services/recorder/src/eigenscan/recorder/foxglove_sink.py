"""All traffic live to Foxglove and Lichtblick, by the Foxglove SDK's WebSocket server."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator, Mapping

import foxglove
from eigenscan.geometry.pose import from_message, to_pose3
from eigenscan.recorder.core import Sink
from eigenscan.recorder.web_viewer import free_port, seen_at
from eigenscan.runtime.recording import descriptors
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from foxglove.websocket import ChannelView, Client, ServerListener
from foxglove_schemas_protobuf.LaserScan_pb2 import LaserScan
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.message import Message

DRAWN = "/drawn"
"""Behind the key of a message that has no schema of Foxglove's: the same as one that its 3D panel draws."""


class FoxgloveSink(Sink):
    """Serves every message on its key as topic, as the recording has it. `url` is for *Open connection*."""

    def __init__(self, host: str, port: int, site: str) -> None:
        """Listens on the port; 0 takes a free one. Raises SettingsError where it is taken."""
        self._counts: Counter[str] = Counter(foxglove_served=0)
        self._channels: dict[str, foxglove.Channel] = {}
        self._latched: dict[str, tuple[bytes, int | None]] = {}
        self._lock = threading.Lock()
        self._context = foxglove.Context()
        self._server = foxglove.start_server(
            name=site,
            host=host,
            port=free_port("foxglove_port", host, port),
            context=self._context,
            server_listener=_Subscriptions(self),
        )
        self.url = f"ws://{seen_at(host)}:{self._server.port}"

    @property
    def counters(self) -> Mapping[str, int]:
        """`foxglove_served`."""
        return self._counts

    def write(self, received: Envelope) -> None:
        """Gives the message to all clients that subscribe to its topic."""
        stamp = getattr(received.message, "timestamp", None)
        # without a stamp the time is now
        time = nanoseconds(stamp) or None if stamp is not None else None
        self._log(received.key, received.message, time, latched=received.channel.qos.latched)
        for drawn in drawings(received.message):
            self._log(received.key + DRAWN, drawn, time, latched=False)
        self._counts["foxglove_served"] += 1

    def repeat(self, topic: str) -> None:
        """Publishes a latched topic's newest message again, for a client that came after it."""
        with self._lock:
            if topic in self._latched:
                data, time = self._latched[topic]
                self._channels[topic].log(data, log_time=time)

    def close(self) -> None:
        """Disconnects all clients."""
        self._server.stop()

    def _log(self, topic: str, message: Message, time: int | None, *, latched: bool) -> None:
        data = message.SerializeToString()
        with self._lock:
            if topic not in self._channels:
                name = message.DESCRIPTOR.full_name
                schema = foxglove.Schema(name=name, encoding="protobuf", data=descriptors(type(message)))
                self._channels[topic] = foxglove.Channel(
                    topic, schema=schema, message_encoding="protobuf", context=self._context
                )
            if latched:
                self._latched[topic] = (data, time)
            self._channels[topic].log(data, log_time=time)


class _Subscriptions(ServerListener):
    """Gives a new subscriber what is latched."""

    def __init__(self, sink: FoxgloveSink) -> None:
        self._sink = sink

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002
        self._sink.repeat(channel.topic)


def drawings(message: Message) -> Iterator[Message]:
    """What Foxglove's 3D panel draws of a scan, and of a claimed pose."""
    if isinstance(message, Scan):
        last = message.angle_min + message.angle_increment * max(len(message.ranges) - 1, 0)
        yield LaserScan(
            timestamp=message.timestamp,
            frame_id=message.frame_id,
            pose=to_pose3(from_message(message.mount)),
            start_angle=message.angle_min,
            end_angle=last,
            ranges=message.ranges,
        )
    elif isinstance(message, PoseEstimate) and message.state == STATE_LOCALIZED:
        yield PoseInFrame(
            timestamp=message.timestamp, frame_id=message.frame_id, pose=to_pose3(from_message(message.pose))
        )
