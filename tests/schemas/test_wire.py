from collections.abc import Callable

import pytest
from eigenscan.schemas.channels import CHANNELS, HEALTH, SCAN, Channel, ContractError
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import decode, encode, encoding
from google.protobuf.message import Message
from hypothesis import given
from hypothesis import strategies as st

Messages = Callable[[type[Message]], st.SearchStrategy[Message]]
CHANNEL = pytest.mark.parametrize("channel", CHANNELS, ids=lambda channel: channel.name)


@CHANNEL
@given(data=st.data())
def test_bytes_give_the_message_back(channel: Channel, messages: Messages, data: st.DataObject) -> None:
    message = data.draw(messages(channel.message))
    payload = encode(message)
    back = decode(channel, payload, encoding(channel))
    assert encode(back) == payload  # and not ==, for NaN is not equal to itself
    assert back.DESCRIPTOR.full_name == channel.schema_name


@CHANNEL
@given(payload=st.binary(max_size=200))
def test_any_bytes_are_a_message_or_a_contract_error(channel: Channel, payload: bytes) -> None:
    try:
        message = decode(channel, payload)
    except ContractError:
        return
    assert isinstance(message, channel.message)


@given(st.dictionaries(st.text("abcdef", max_size=4), st.integers(0, 9), min_size=2), st.randoms())
def test_the_order_of_making_does_not_show_in_the_bytes(counters: dict[str, int], random: object) -> None:
    shuffled = list(counters.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert encode(Health(counters=counters)) == encode(Health(counters=dict(shuffled)))


@pytest.mark.parametrize(
    "declared",
    [
        "application/protobuf;eigenscan.Scan/2",
        "application/protobuf;eigenscan.Scan",
        "application/protobuf;eigenscan.RawScan/1",
        "application/json",
        "text/plain",
        "application/json;eigenscan.Scan/1",
    ],
)
def test_another_schema_version_or_encoding_is_refused(declared: str) -> None:
    payload = encode(Scan(sequence=7))
    with pytest.raises(ContractError) as refusal:
        decode(SCAN, payload, declared)
    assert declared in str(refusal.value)
    assert "eigenscan.Scan/1" in str(refusal.value)


@pytest.mark.parametrize(
    "declared", [None, "", "zenoh/bytes", "application/octet-stream", "application/protobuf"]
)
def test_an_encoding_without_a_schema_leaves_the_channels_own(declared: str | None) -> None:
    assert decode(SCAN, encode(Scan(sequence=7)), declared) == Scan(sequence=7)


def test_a_field_of_a_later_version_is_skipped() -> None:
    later = encode(Scan(sequence=7)) + bytes([0xFA, 0x7F, 3]) + b"new"  # field 2047, three bytes
    message = decode(SCAN, later, encoding(SCAN))
    assert isinstance(message, Scan)
    assert message.sequence == 7


@given(st.integers(0, 2**62))
def test_stamps_keep_every_nanosecond(time: int) -> None:
    assert nanoseconds(stamp(time)) == time


def test_an_envelope_opens_as_what_it_holds_only() -> None:
    envelope = Envelope(SCAN, {"site": "s", "robot": "r", "lidar": "l"}, Scan(sequence=1))
    assert envelope.open(Scan).sequence == 1
    with pytest.raises(
        ContractError, match=r"s/robot/r/scan/l: expected eigenscan.RawScan, got eigenscan.Scan"
    ):
        envelope.open(RawScan)


def test_the_encoding_names_schema_and_contract() -> None:
    assert encoding(HEALTH) == "application/protobuf;eigenscan.Health/1"
