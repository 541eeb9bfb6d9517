"""The bridge's connection to the MQTT broker: reconnects, sets a last will, and stamps messages."""

from __future__ import annotations

import json
import ssl
import sys
from collections import Counter
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from eigenscan.runtime.inbox import Inbox
from eigenscan.runtime.settings import SettingsError
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import encode, encoding
from eigenscan.vda5050.channels import (
    BROKER,
    CONNECTION,
    FACTSHEET,
    INSTANT_ACTIONS,
    MQTT_PUBLISHED,
    MQTT_RECEIVED,
    ORDER,
)
from eigenscan.vda5050.options import Vda5050Options
from google.protobuf.wrappers_pb2 import BytesValue
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

KEEP_ALIVE_S = 15
"""After one and a half of it without a sign of life, the broker publishes the last will."""
RECONNECT_S = (1, 10)
"""First and longest wait before it connects again."""
MOST_BYTES = 262_144
"""Largest message that is read."""
CLOSE_S = 0.5
NO_ACCESS = (134, 135)
"""Reason codes (MQTT 5, 2.4): bad user name or password; not authorized."""
OTHER_NAME = (62, 64)
"""OpenSSL's codes where the certificate is for another host name or address."""


class MqttPort:
    """Publishes and receives a robot's topics of VDA 5050."""

    channels: tuple[Channel, ...] = (MQTT_RECEIVED, MQTT_PUBLISHED)

    def __init__(self, options: Vda5050Options) -> None:
        self._options = options
        self._inbox: Inbox | None = None
        self._numbers: Counter[str] = Counter()
        self._connected = self._refused = False
        broken = {2: "CONNECTIONBROKEN", 3: "CONNECTION_BROKEN"}[options.major]
        self._client = Client(CallbackAPIVersion.VERSION2, client_id=f"eigenscan-{options.serial}")
        if not options.only_visualization:
            self._client.will_set(self._topic(CONNECTION), self._connection(broken), qos=1, retain=True)
        password = self._password()
        if options.username:
            self._client.username_pw_set(options.username, password)
        elif password:
            raise SettingsError("password_file: without a username: give username too")
        if options.address[2]:
            self._client.tls_set_context(self._tls())
        self._client.reconnect_delay_set(*RECONNECT_S)
        self._client.on_connect = self._on_connect
        self._client.on_connect_fail = self._on_connect_fail
        self._client.on_disconnect = self._on_disconnect
        self._client.on_message = self._on_message

    def open(self, inbox: Inbox) -> None:
        """Connects, and again whenever it must; a broker that is not there is waited for."""
        self._inbox = inbox
        host, port, _ = self._options.address
        self._client.connect_async(host, port, keepalive=KEEP_ALIVE_S)
        self._client.loop_start()

    def publish(self, envelope: Envelope) -> None:
        """Publishes one message, dated now."""
        topic = envelope.address["topic"]
        body = {"timestamp": _now(), **json.loads(envelope.open(BytesValue).value)}
        if self._client.is_connected():
            self._client.publish(self._topic(topic), json.dumps(body), qos=0, retain=topic == FACTSHEET)

    def close(self) -> None:
        """Publishes the end and disconnects."""
        if self._client.is_connected() and not self._options.only_visualization:
            last = self._client.publish(
                self._topic(CONNECTION), self._connection("OFFLINE"), qos=1, retain=True
            )
            with suppress(RuntimeError):  # the connection ended just now
                last.wait_for_publish(CLOSE_S)
        self._client.disconnect()
        self._client.loop_stop()

    def _topic(self, name: str) -> str:
        return f"{self._options.topics}/{name}"

    def _password(self) -> str:
        path = self._options.password_file
        try:
            return "" if path is None else path.read_text(encoding="utf-8").strip()
        except OSError as error:
            raise SettingsError(f"password_file: {error}") from error

    def _tls(self) -> ssl.SSLContext:
        try:
            return ssl.create_default_context(cafile=self._options.ca_file)
        except OSError as error:
            raise SettingsError(f"ca_file: {self._options.ca_file}: {error.strerror or error}") from error

    def _connection(self, state: str) -> str:
        fields = {
            "headerId": self._numbers[CONNECTION],
            "timestamp": _now(),
            "version": self._options.version,
            "manufacturer": self._options.manufacturer,
            "serialNumber": self._options.serial,
            "connectionState": state,
        }
        self._numbers[CONNECTION] += 1
        return json.dumps(fields)

    def _report(self, words: str) -> None:
        self._put(BROKER, words.encode())

    def _put(self, topic: str, data: bytes) -> None:
        assert self._inbox is not None
        key = MQTT_RECEIVED.key({"topic": topic})
        self._inbox.put(MQTT_RECEIVED, key, encode(BytesValue(value=data)), encoding(MQTT_RECEIVED))

    def _on_connect(self, client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        self._refused = reason.is_failure
        if reason.is_failure:
            fix = ": check username and password_file" if reason.value in NO_ACCESS else ""
            self._report(f"refuses: {reason}{fix}")
            return
        self._connected = True
        if not self._options.only_visualization:
            client.subscribe([(self._topic(name), 0) for name in (INSTANT_ACTIONS, ORDER)])
            client.publish(self._topic(CONNECTION), self._connection("ONLINE"), qos=1, retain=True)
        self._report("")

    def _on_connect_fail(self, _client: Client, _data: Any) -> None:
        error = sys.exc_info()[1]  # paho calls this while it handles what went wrong, and passes nothing on
        self._report(f"{self._options.broker} cannot be reached: {_cause(error)}")

    def _on_disconnect(self, _client: Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        refused, self._refused = self._refused, False
        if refused:  # the reason was reported
            return
        fix = "" if self._connected or self._options.address[2] else ": mqtts://, if the broker speaks TLS"
        self._report(f"connection lost: {reason}{fix}")

    def _on_message(self, _client: Client, _data: Any, message: MQTTMessage) -> None:
        topic = message.topic.rpartition("/")[2]
        # longer than any action: the core refuses a cut message
        self._put(topic, bytes(message.payload[:MOST_BYTES]))


def _cause(error: BaseException | None) -> str:
    """Why a connection failed, and what to set."""
    if isinstance(error, ssl.SSLCertVerificationError):
        fix = "" if error.verify_code in OTHER_NAME else ": set ca_file"
        return f"its certificate is not trusted: {error.verify_message.rstrip('.')}{fix}"
    return getattr(error, "strerror", None) or str(error or "no reason given")


def _now() -> str:
    """ISO 8601, UTC, ms."""
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
