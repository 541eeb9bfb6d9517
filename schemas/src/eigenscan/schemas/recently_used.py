"""What is remembered of each of many robots that come and go, in bounded memory.

Time is counted in uses, not by a clock: the same messages always leave the same memory.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")

AMONG = 100_000
"""Messages of others after which a silent publisher is forgotten: a minute and more of all the robots that
one process can serve."""


class RecentlyUsed(Generic[K, V]):
    """A dictionary that forgets what was not among the last AMONG uses, the least recently used first."""

    def __init__(self, forget: Callable[[V], object] = lambda _: None) -> None:
        """`forget` is called with each value that goes."""
        self._kept: OrderedDict[K, tuple[int, V]] = OrderedDict()  # the longest unused first
        self._uses = self._looks = 0
        self._among, self._forget = AMONG, forget

    def use(self, key: K, make: Callable[[], V]) -> V:
        """The value of `key`, made where there is none (any more)."""
        self._uses += 1
        known = self._kept.pop(key, None)
        value = make() if known is None else known[1]
        self._kept[key] = self._uses, value
        if self._uses >= self._looks:  # before, even what was longest unused then is not due
            longest, (used, unused) = next(iter(self._kept.items()))
            if self._uses - used >= self._among:
                del self._kept[longest]
                self._forget(unused)
            self._looks = next(iter(self._kept.values()))[0] + self._among
        return value

    def get(self, key: K) -> V | None:
        """The value of `key`, None where there is none (any more); that is no use."""
        known = self._kept.get(key)
        return None if known is None else known[1]

    def items(self) -> Iterator[tuple[K, V]]:
        """All that is remembered."""
        return ((key, value) for key, (_, value) in self._kept.items())

    def __len__(self) -> int:
        return len(self._kept)
