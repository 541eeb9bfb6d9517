"""The MQTT port towards a broker of which only the first answer matters."""

from __future__ import annotations

import socket
import threading
import time
from unittest import mock

import pytest
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.wire import decode
from eigenscan.vda5050.channels import MQTT_RECEIVED
from eigenscan.vda5050.options import Vda5050Options
from eigenscan.vda5050.port import MqttPort
from google.protobuf.wrappers_pb2 import BytesValue

PATIENCE_S = 20.0


def next_report(inbox: Inbox) -> str | None:
    arrival = inbox.take(0.1)
    if arrival is None:
        return None
    message = decode(MQTT_RECEIVED, arrival.payload, arrival.encoding)
    assert isinstance(message, BytesValue)
    return message.value.decode()


def test_a_broker_that_goes_as_the_bridge_ends_does_not_keep_it_from_closing() -> None:
    """Both end at once where a machine does; paho raises an error for what it cannot publish any more."""
    port = MqttPort(Vda5050Options(broker="mqtt://127.0.0.1:1", robot="r1"))
    port.open(Inbox())
    with mock.patch.object(port._client, "is_connected", return_value=True):
        port.close()
    assert port._client._thread is None


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (3, "refuses: Server unavailable"),
        (4, "refuses: Bad user name or password: check username and password_file"),
        (5, "refuses: Not authorized: check username and password_file"),
    ],
)
def test_what_a_broker_refuses_for_is_the_last_word(code: int, words: str) -> None:
    """Not that the connection was lost, as it is after each refusal."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def refuse() -> None:
            connection, _ = listening.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(bytes([0x20, 2, 0, code]))  # CONNACK (MQTT 3.1.1, 3.2)
                connection.recv(4096)

        threading.Thread(target=refuse, daemon=True).start()
        broker = f"mqtt://127.0.0.1:{listening.getsockname()[1]}"
        port, inbox = MqttPort(Vda5050Options(broker=broker, robot="r1")), Inbox()
        port.open(inbox)
        reports: list[str] = []
        end = time.monotonic() + PATIENCE_S
        while time.monotonic() < end and (not reports or inbox.is_waiting):
            reports += filter(None, [next_report(inbox)])
        time.sleep(0.3)  # paho tells of the end right after the refusal
        reports += filter(None, [next_report(inbox)])
        port.close()
    assert reports == [words]
