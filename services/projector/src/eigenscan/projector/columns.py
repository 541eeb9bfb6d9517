"""Many messages of one kind from columns of numbers, as protobuf's bytes.

A message that is put together number by number takes several times as long as one that is parsed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Record = NDArray[Any]
"""Fields of one message as they lie in its bytes; the part `value` of each is to be filled in."""

_VARINT, _DOUBLE, _LENGTH = 0, 1, 2
"""Wire types: a number in steps of 7 bits, 8 bytes, a length and so many bytes."""


def doubles(*numbers: int) -> Record:
    """Fields `numbers` (k,) of the type double, of values (k,)."""
    blank = np.zeros(len(numbers), [("tag", "u1"), ("value", "<f8")])
    blank["tag"] = [number << 3 | _DOUBLE for number in numbers]
    return blank


def flag(number: int) -> Record:
    """A field of the type bool."""
    return np.array((number << 3 | _VARINT, 0), [("tag", "u1"), ("value", "u1")])


def floats(number: int, count: int) -> Record:
    """A repeated field of the type float, of values (count,)."""
    return _headed(number, np.zeros(count, "<f4"))


def packed(number: int, values: NDArray[np.float32]) -> bytes:
    """A repeated field of the type float with its values (count,)."""
    return _head(number, 4 * len(values)) + values.astype("<f4").tobytes()


def nested(number: int, *numbers: int) -> Record:
    """A field that is a message with the fields `numbers` (k,) of the type double, of values (k,)."""
    return _headed(number, doubles(*numbers))


def record(**fields: Record) -> Record:
    """A message of fields by their names."""
    blank = np.zeros((), [(name, field.dtype, field.shape) for name, field in fields.items()])
    for name, field in fields.items():
        blank[name] = field
    return blank


def messages(
    number: int, blank: Record, names: tuple[int, Sequence[str]], values: Mapping[str, ArrayLike]
) -> bytes:
    """A repeated field of n messages like `blank`, with values (n, ...) by their fields' names.

    `names`: the number of the messages' text field, and its n texts.
    """
    rows = np.empty(len(names[1]), blank.dtype)
    rows[:] = blank
    for name, column in values.items():
        field = rows[name]["value"]
        if field.dtype.names:
            field = field["value"]
        field[...] = column
    content, size = rows.tobytes(), blank.nbytes
    parts: list[bytes] = []
    for i, text in enumerate(names[1]):
        parts += _text(number, names[0], text, size), content[i * size : (i + 1) * size]
    return b"".join(parts)


@lru_cache(maxsize=4096)  # a site's regions, which come with each scan
def _text(number: int, named: int, text: str, size: int) -> bytes:
    """What comes before a message's `size` bytes: its head, and its text field."""
    encoded = text.encode()
    name = _head(named, len(encoded)) + encoded
    return _head(number, len(name) + size) + name


def _headed(number: int, content: Record) -> Record:
    head = np.frombuffer(_head(number, content.nbytes), dtype=np.uint8)
    blank = np.zeros((), [("head", "u1", len(head)), ("value", content.dtype, content.shape)])
    blank["head"], blank["value"] = head, content
    return blank


def _head(number: int, length: int) -> bytes:
    """Tag and length of a field."""
    head = bytearray()
    for number_or_length in (number << 3 | _LENGTH, length):
        left = number_or_length
        while left > 0x7F:
            head.append(left & 0x7F | 0x80)
            left >>= 7
        head.append(left)
    return bytes(head)
