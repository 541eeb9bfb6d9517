"""Messages to and from bytes, with the schema's name and contract version in the encoding.

The encoding reads `application/protobuf;eigenscan.Scan/1`.
"""

from __future__ import annotations

from functools import cache

from eigenscan.schemas.channels import CONTRACT_VERSION, Channel, ContractError
from google.protobuf.message import DecodeError, Message

MEDIA_TYPE = "application/protobuf"
UNDECLARED = {"", "zenoh/bytes", "application/octet-stream", MEDIA_TYPE}
"""Encodings that leave the schema open."""


@cache
def encoding(channel: Channel) -> str:
    """Encoding string for the channel's samples."""
    return f"{MEDIA_TYPE};{channel.schema_name}/{CONTRACT_VERSION}"


def encode(message: Message) -> bytes:
    """Bytes of `message`; the same message always gives the same bytes."""
    return message.SerializeToString(deterministic=True)


def decode(channel: Channel, payload: bytes, declared: str | None = None) -> Message:
    """Message in `payload`.

    `declared` is the sample's encoding; where it is absent or names no schema the channel's own is assumed.
    Raises ContractError for another encoding, schema or contract version, or bytes that do not decode.
    """
    expected = encoding(channel)
    if declared and declared != expected and declared not in UNDECLARED:
        raise ContractError(f"{channel.name}: encoding {declared!r}, this build speaks {expected!r}")
    message = channel.message()
    try:
        message.ParseFromString(payload)
    except DecodeError as error:
        raise ContractError(f"{channel.name}: {len(payload)} bytes do not decode as {expected}") from error
    return message
