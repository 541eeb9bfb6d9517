"""Many messages of one kind from columns of numbers, as protobuf's bytes.

A message that is put together number by number takes several times as long as one that is parsed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from eigenscan.geometry.message_floats import head
from numpy.typing import ArrayLike, NDArray

Record = NDArray[Any]
"""Fields of one message as they lie in its bytes; the part `value` of each is to be filled in."""

_VARINT, _DOUBLE = 0, 1
"""Wire types: a number in steps of 7 bits, and 8 bytes."""


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
    rows = blank.reshape(1).repeat(len(names[1]))  # to assign it takes ten times as long
    for name, column in values.items():
        field = rows[name]["value"]
        if field.dtype.names:
            field = field["value"]
        field[...] = column
    size = blank.nbytes
    parts = [b""] * (2 * len(rows))
    parts[::2] = [_text(number, names[0], text, size) for text in names[1]]
    parts[1::2] = rows.view(f"V{size}").tolist()
    return b"".join(parts)


@lru_cache(maxsize=4096)  # a site's regions, which come with each scan
def _text(number: int, named: int, text: str, size: int) -> bytes:
    """What comes before a message's `size` bytes: its head, and its text field."""
    encoded = text.encode()
    name = head(named, len(encoded)) + encoded
    return head(number, len(name) + size) + name


def _headed(number: int, content: Record) -> Record:
    front = np.frombuffer(head(number, content.nbytes), dtype=np.uint8)
    blank = np.zeros((), [("head", "u1", len(front)), ("value", content.dtype, content.shape)])
    blank["head"], blank["value"] = front, content
    return blank
