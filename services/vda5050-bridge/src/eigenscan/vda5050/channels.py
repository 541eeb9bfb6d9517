"""VDA 5050's messages as the bridge's core exchanges them: JSON, by topic."""

from __future__ import annotations

from eigenscan.schemas.channels import Channel, Qos
from google.protobuf.wrappers_pb2 import BytesValue

MQTT_RECEIVED = Channel("mqtt_heard", "heard/{topic}", BytesValue, Qos(depth=256), "input from the broker")
MQTT_PUBLISHED = Channel("mqtt_said", "said/{topic}", BytesValue, about="output to the broker")

ORDER, INSTANT_ACTIONS = "order", "instantActions"
"""Topics that fleet managers publish."""
STATE, VISUALIZATION, FACTSHEET, CONNECTION = "state", "visualization", "factsheet", "connection"
"""Topics that a robot publishes."""
BROKER = "broker"
"""A topic outside the standard: the port publishes the connection's fault on it, empty if there is none."""
