"""Damaged and forged inputs, each made from a seed alone: the same number gives the same bytes everywhere."""

from __future__ import annotations

import contextlib
import math
import re
import struct
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

from google.protobuf.descriptor import FieldDescriptor
from google.protobuf.message import DecodeError, Message

MOST_BYTES = 1_000_000
"""Of one input: what an attacker sends often, or what a user opens without a thought."""

_WORDS = [
    *(b"nan", b"inf", b"-inf", b"1e308", b"-1e308", b"1e-308", b"1e-9", b"0", b"-0.0", b"-1", b"2147483647"),
    *(b"4294967295", b"-2147483648", b"9223372036854775807", b"18446744073709551616", b"9" * 5000, b"0x7f"),
    *(b"1e400", b"true", b"null", b'""', b"[]", b"{}", b"~", b"*a", b"&a", b"!!python/object:os.system"),
    *(b"../../../etc/passwd", b"/dev/zero", b"%s%n", b"\x1b]0;x\x07", b"\xe2\x80\xae", b"\x00", b"\xff\xfe"),
]
_FORMATS = ["<B", "<H", ">H", "<I", ">I", "<Q", ">Q", "<f", "<d", ">d"]
_NUMBERS: list[float] = [
    *(0, 1, 2, 3, 7, 8, 127, 128, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63),
    *(math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, 1e-9, -1.0, 1e7, 1e19, 0.1),
]
_TEXTS = [
    *(
        "",
        "\x1b[2J\x1b]0;owned\x07",
        "\u202egnp.exe",
        "x" * 5000,
        "../../etc/passwd",
        "a/b",
        "*",
        "nan",
        "{}",
    ),
    *("[" * 3000, '{"robot": ["*"]}', '"text"', "\x00", "ok\nDEGRADED", "é" * 300, "%n%s"),
]


def damaged(random: Random, seed: bytes, others: Sequence[bytes]) -> bytes:
    """`seed` with one to eight changes; `others` lend pieces."""
    data = bytearray(seed)
    for _ in range(1 << random.randrange(4)):
        random.choice(_CHANGES)(random, data, others)
    return bytes(data[:MOST_BYTES])


def _place(random: Random, data: bytearray) -> int:
    """Anywhere; half of the times near the start, where headers are."""
    return random.randrange(min(len(data), 64) if random.random() < 0.5 else len(data)) if data else 0


def _flip(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    if data:
        data[_place(random, data)] ^= 1 << random.randrange(8)


def _set(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    if data:
        data[_place(random, data)] = random.choice((0, 1, 127, 128, 255, random.randrange(256)))


def _number(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    """A binary number of some width in the place of what is there."""
    form, value = random.choice(_FORMATS), random.choice(_NUMBERS)
    if form[1] in "fd":
        large = form[1] == "f" and abs(value) > 1e38
        piece = struct.pack(form, math.copysign(math.inf, value) if large else value)
    else:
        whole = int(value) if math.isfinite(value) else 0
        piece = struct.pack(form, whole % (1 << 8 * struct.calcsize(form)))
    at = _place(random, data)
    data[at : at + len(piece)] = piece


def _word(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    """A word in the place of a number or a name that is written in letters."""
    found = list(re.finditer(rb"[-+.\w]+", bytes(data[:50_000])))
    start, end = random.choice(found).span() if found else (0, 0)
    data[start:end] = random.choice(_WORDS)


def _cut(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    del data[_place(random, data) :]


def _drop(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    at = _place(random, data)
    del data[at : at + random.choice((1, 2, 4, 8, 100, 1000))]


def _repeat(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    at, size = _place(random, data), random.choice((1, 2, 8, 50, 500))
    times = random.choice((1, 2, 10, 1000)) if len(data) < 100_000 else 1
    data[at:at] = bytes(data[at : at + size]) * times


def _splice(random: Random, data: bytearray, others: Sequence[bytes]) -> None:
    other = random.choice(others) if others else b""
    if other:
        at, begin = _place(random, data), random.randrange(len(other))
        data[at:at] = other[begin : begin + random.choice((4, 16, 100, 2000))]


def _line(random: Random, data: bytearray, _others: Sequence[bytes]) -> None:
    """A line is missing, stands twice or elsewhere."""
    lines = bytes(data).splitlines(keepends=True)[:5000]
    if len(lines) > 1:
        line = lines.pop(random.randrange(len(lines)))
        for _ in range(random.randrange(3)):
            lines.insert(random.randrange(len(lines) + 1), line)
        data[:] = b"".join(lines)


_Change = Callable[[Random, bytearray, Sequence[bytes]], None]
_CHANGES: list[_Change] = [_flip, _set, _number, _number, _word, _word, _cut, _drop, _repeat, _splice, _line]


def forged(random: Random, kind: type[Message], seeds: Sequence[bytes]) -> bytes:
    """The bytes of a message of `kind`: one of `seeds` with fields that nobody honest would give."""
    message = kind()
    with contextlib.suppress(DecodeError):
        message.ParseFromString(random.choice(seeds))
    for _ in range(1 << random.randrange(4)):
        _forge(random, message)
    data = message.SerializeToString()
    if random.random() < 0.1:
        data = damaged(random, data, seeds)
    return data[:MOST_BYTES]


def _forge(random: Random, message: Message, depth: int = 0) -> None:
    """Changes one field of `message`, or of what it holds."""
    fields: list[FieldDescriptor] = list(message.DESCRIPTOR.fields)  # type: ignore[arg-type]
    if not fields or depth > 5:
        return
    field = random.choice(fields)
    value: Any = getattr(message, field.name)
    if field.message_type is not None and field.message_type.GetOptions().map_entry:
        for _ in range(random.choice((1, 1, 1000))):
            value[random.choice(_TEXTS)[:50] + str(random.randrange(10**6))] = 2**62
    elif field.is_repeated:
        _forge_list(random, field, value, depth)
    elif field.message_type is not None:
        if random.random() < 0.1:
            message.ClearField(field.name)
        else:
            _forge(random, value, depth + 1)
            value.SetInParent()
    else:
        setattr(message, field.name, _value(random, field))


def _forge_list(random: Random, field: FieldDescriptor, value: Any, depth: int) -> None:
    what = random.randrange(5)
    if what == 0:
        del value[random.randrange(len(value) + 1) :]
    elif field.message_type is not None:
        for _ in range(random.choice((1, 1, 2, 500)) if what == 1 or not len(value) else 0):
            value.add().MergeFrom(value[0])
        if len(value):
            _forge(random, value[random.randrange(len(value))], depth + 1)
    elif what == 1:
        value.extend([_value(random, field)] * random.choice((1, 2, 100, 20_000)))
    elif len(value) and what < 4:
        value[random.randrange(len(value))] = _value(random, field)
    elif len(value) <= 20_000:
        value.extend(list(value))


def _value(random: Random, field: FieldDescriptor) -> Any:
    """Something that the field's type can hold."""
    kind, types = field.type, FieldDescriptor
    if kind in (types.TYPE_DOUBLE, types.TYPE_FLOAT):
        return random.choice(_NUMBERS) if random.random() < 0.7 else random.gauss(0.0, 10.0)
    if kind == types.TYPE_STRING:
        return random.choice(_TEXTS)
    if kind == types.TYPE_BYTES:
        return random.choice((b"", b"\xff" * 100, bytes(10_000), random.randbytes(50)))
    if kind == types.TYPE_BOOL:
        return random.random() < 0.5
    if kind == types.TYPE_ENUM:
        return random.choice((0, 1, 2, 3, 99, -1, 2**31 - 1))
    wide = kind in (
        types.TYPE_INT64,
        types.TYPE_SINT64,
        types.TYPE_SFIXED64,
        types.TYPE_UINT64,
        types.TYPE_FIXED64,
    )
    signed = kind not in (types.TYPE_UINT32, types.TYPE_UINT64, types.TYPE_FIXED32, types.TYPE_FIXED64)
    most = (1 << (63 if wide else 31)) - 1
    least = -most - 1 if signed else 0
    return max(
        least, min(most, random.choice((0, 1, 2, 100, 65535, most, least, -1, random.randrange(10**6))))
    )
