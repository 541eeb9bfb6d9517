"""ROS 2's messages as the bridge's core exchanges them: CDR bytes, by the name of topic or service."""

from __future__ import annotations

from eigenscan.schemas.channels import Channel, Qos
from google.protobuf.wrappers_pb2 import BytesValue

ROS_RECEIVED = Channel("ros_heard", "heard/{endpoint}", BytesValue, Qos(depth=1024), "input from ROS")
ROS_ASKED = Channel(
    "ros_asked", "asked/{endpoint}/{number}", BytesValue, Qos(depth=64), "a request to a service"
)
ROS_ANSWERED = Channel(
    "ros_answered", "answered/{endpoint}/{number}", BytesValue, about="its response; empty: there is none"
)
ROS_PUBLISHED = Channel("ros_said", "said/{endpoint}", BytesValue, about="output to ROS")
