"""A message's repeated field of the type float as an array, and back, by its bytes.

Number by number, a scan of 361 beams takes 20 us either way, one of 1,081 takes 50 to 70; by its bytes 2.
"""

from __future__ import annotations

import numpy as np
from google.protobuf.message import Message
from numpy.typing import NDArray

Singles = NDArray[np.float32]
_WIRE = np.dtype("<f4")
_LENGTH = 2
"""Wire type: a length and so many bytes."""


def floats_of(message: Message, field: str) -> Singles:
    """The numbers (n,) in `field`, an array of its own."""
    values = getattr(message, field)
    if not values:
        return np.empty(0, dtype=np.float32)
    alone = type(message)(**{field: values}).SerializeToString()
    return np.frombuffer(alone, _WIRE, offset=len(alone) - _WIRE.itemsize * len(values)).astype(np.float32)


def put_floats(message: Message, number: int, values: Singles) -> None:
    """Appends the numbers (n,) to the field of this number."""
    message.MergeFromString(packed(number, values))


def packed(number: int, values: Singles) -> bytes:
    """A field with its numbers (n,)."""
    return head(number, _WIRE.itemsize * len(values)) + values.astype(_WIRE).tobytes()


def head(number: int, length: int) -> bytes:
    """Tag and length of a field."""
    written = bytearray()
    for number_or_length in (number << 3 | _LENGTH, length):
        left = number_or_length
        while left > 0x7F:
            written.append(left & 0x7F | 0x80)
            left >>= 7
        written.append(left)
    return bytes(written)
