"""Counts the shapes of a drawing after all references are resolved."""

from __future__ import annotations

from collections.abc import Callable, Iterable

MOST_PLACED = 1_000_000
"""Shapes of one drawing, blocks put in place: a hundred times those of a large floor."""


class TooMuchError(ValueError):
    """More than MOST_PLACED shapes, or something that contains itself."""


def placed(start: str, refers: Callable[[str], Iterable[tuple[str, int]]], own: Callable[[str], int]) -> int:
    """Number of shapes of `start`: its `own`, and those that it `refers` to, times their counts.

    Raises TooMuchError; takes time in proportion to the references, not to the result.
    """
    totals: dict[str, int] = {}
    begun: set[str] = set()
    stack = [start]
    while stack:
        name = stack[-1]
        if name in totals:
            stack.pop()
            continue
        parts = list(refers(name))
        waiting = [part for part, _ in parts if part not in totals]
        if waiting and name not in begun:
            begun.add(name)
            if any(part in begun for part in waiting):
                raise TooMuchError(f"{name[:80]!r} contains itself")
            stack += waiting
            continue
        totals[name] = own(name) + sum(times * totals[part] for part, times in parts)
        if totals[name] > MOST_PLACED:
            raise TooMuchError(f"{name[:80]!r} becomes more than {MOST_PLACED} shapes")
        stack.pop()
    return totals[start]
