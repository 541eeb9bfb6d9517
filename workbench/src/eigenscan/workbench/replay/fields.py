"""Finds the fields in which two messages differ."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from google.protobuf.message import Message

Tolerance = tuple[float, float]
"""Absolute, in the field's unit, and relative to the larger of the two values."""

TOLERANCES: dict[str, Tolerance] = {
    # m and rad: a thousandth of any lidar's resolution
    "x": (1e-5, 0.0),
    "y": (1e-5, 0.0),
    "theta": (1e-5, 0.0),
    "mount": (1e-7, 0.0),
    "inexactness": (1e-6, 0.0),
    "ranges": (1e-5, 0.0),
    "angle_min": (1e-7, 0.0),
    "angle_increment": (1e-7, 0.0),
    "error": (1e-4, 0.0),
    "error_energy": (1e-5, 0.0),
    "sensor_x": (1e-4, 0.0),
    "sensor_y": (1e-4, 0.0),
    "map_x": (1e-4, 0.0),
    "map_y": (1e-4, 0.0),
    "coefficients": (1e-3, 1e-4),
    "covariance": (1e-7, 1e-3),
    # natural logarithms and probabilities
    "log_likelihood": (1e-4, 1e-6),
    "unlisted_log_likelihood": (1e-4, 1e-6),
    "gain": (2e-4, 2e-6),
    "explained": (1e-6, 0.0),
    "confidence": (1e-5, 0.0),
    "probability": (1e-5, 0.0),
    "none_probability": (1e-5, 0.0),
    "nis": (1e-4, 1e-3),
    "protection_radius": (1e-5, 1e-3),
    "protection_angle": (1e-5, 1e-3),
    "age": (1e-7, 0.0),
    # the parts of a transform, which have different units
    "translation": (1e-5, 0.0),
    "rotation": (1e-5, 0.0),
}
"""Differences that `--tolerant` allows, because sums in numpy end differently on another processor.

By the name of a field or of a message around it, the innermost that is named here. All others must be equal.
"""
_ANGLES = {"theta"}
_ABSENT = "(absent)"


@dataclass(frozen=True)
class Difference:
    """One field with both of its values; `path` reads such as `hypotheses[3].pose.x`."""

    path: str
    recorded: Any
    replayed: Any

    @property
    def name(self) -> str:
        """The path without indices."""
        return ".".join(part.partition("[")[0] for part in self.path.split("."))


def differences(recorded: Message, replayed: Message, *, tolerant: bool = False) -> Iterator[Difference]:
    """Fields that differ, in the order of the contract; within TOLERANCES where `tolerant`."""
    yield from _messages(recorded, replayed, "", None, TOLERANCES if tolerant else {})


def _messages(
    a: Message, b: Message, prefix: str, around: Tolerance | None, table: dict[str, Tolerance]
) -> Iterator[Difference]:
    for field in a.DESCRIPTOR.fields:
        path = f"{prefix}{field.name}"
        tolerance = table.get(field.name, around)
        left, right = getattr(a, field.name), getattr(b, field.name)
        if field.is_repeated:
            yield from _lists(list(left), list(right), path, tolerance, table)
        elif field.message_type is None:
            if not _same(left, right, field.name, tolerance):
                yield Difference(path, _named(field, left), _named(field, right))
        elif a.HasField(field.name) != b.HasField(field.name):
            shown = [
                str(m).strip() if o.HasField(field.name) else _ABSENT for o, m in ((a, left), (b, right))
            ]
            yield Difference(path, *(" ".join(text.split()) for text in shown))
        else:
            yield from _messages(left, right, f"{path}.", tolerance, table)


def _lists(
    left: Sequence[Any],
    right: Sequence[Any],
    path: str,
    tolerance: Tolerance | None,
    table: dict[str, Tolerance],
) -> Iterator[Difference]:
    if len(left) != len(right):
        yield Difference(f"{path}.length", len(left), len(right))
    name = path.rpartition(".")[2]
    for index, (a, b) in enumerate(zip(left, right, strict=False)):
        if isinstance(a, Message):
            yield from _messages(a, b, f"{path}[{index}].", tolerance, table)
        elif not _same(a, b, name, tolerance):
            yield Difference(f"{path}[{index}]", a, b)


def _same(a: Any, b: Any, name: str, tolerance: Tolerance | None) -> bool:
    if not isinstance(a, float):
        return bool(a == b)
    if a == b:
        # 0.0 and -0.0 are other bytes
        return tolerance is not None or math.copysign(1.0, a) == math.copysign(1.0, b)
    if math.isnan(a) and math.isnan(b):
        return True
    if tolerance is None or not (math.isfinite(a) and math.isfinite(b)):
        return False
    gap = abs(a - b)
    if name in _ANGLES:
        gap = abs(math.remainder(a - b, math.tau))
    return bool(gap <= max(tolerance[0], tolerance[1] * max(abs(a), abs(b))))


def _named(field: Any, value: Any) -> Any:
    """Enum values by name."""
    if field.enum_type is None:
        return value
    known = field.enum_type.values_by_number.get(value)
    return known.name if known else value
