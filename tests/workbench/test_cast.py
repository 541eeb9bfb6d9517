"""A playback at another time: all stamps of a message move together."""

from eigenscan.schemas.channels import HEADING, HEALTH, MODEL_SET, SCAN, SCAN_MOTION, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.heading_pb2 import Heading
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import Scan, ScanMotion
from eigenscan.workbench.playback.cast import shifted
from google.protobuf.message import Message

NOW, BY = 10**18, 7 * 10**17


def later(channel: Channel, message: Message) -> Message:
    address = dict.fromkeys(channel.fields, "x")
    return shifted(Envelope(channel, address, message), BY).message


def motion() -> ScanMotion:
    return ScanMotion(timestamp=stamp(NOW), since=stamp(NOW - 200_000_000), explained=0.9)


def test_a_motion_keeps_its_duration() -> None:
    for channel, message in (
        (SCAN_MOTION, motion()),
        (HEADING, Heading(timestamp=stamp(NOW), since=stamp(NOW - 5))),
    ):
        moved = later(channel, message)
        assert isinstance(moved, ScanMotion | Heading)
        assert nanoseconds(moved.timestamp) == NOW + BY
        assert nanoseconds(moved.timestamp) - nanoseconds(moved.since) == NOW - nanoseconds(message.since)


def test_what_a_message_holds_moves_along() -> None:
    moved = later(SCAN, Scan(timestamp=stamp(NOW), ranges=[1.0, 2.0], motion=motion()))
    assert isinstance(moved, Scan)
    assert nanoseconds(moved.motion.since) == NOW - 200_000_000 + BY
    assert list(moved.ranges) == [1.0, 2.0]


def test_counters_are_no_stamps() -> None:
    moved = later(HEALTH, Health(timestamp=stamp(NOW), counters={"lost": 3}))
    assert moved == Health(timestamp=stamp(NOW + BY), counters={"lost": 3})


def test_a_model_set_keeps_its_stamp() -> None:
    message = ModelSet(version="1")
    assert later(MODEL_SET, message) is message
