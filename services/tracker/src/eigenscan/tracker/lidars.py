"""What is known of each lidar of one robot, and which of them still send scans."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, TypeVar

V = TypeVar("V")

GONE_NS = 10_000_000_000
"""Who sent nothing for so long sends nothing any more: the time after which health misses an input."""
MOST = 32
"""Lidars of a robot that something is known of; a sender may invent names."""


class Lidars(Generic[V]):
    """By lidar what is known of it.

    A lidar that was switched off says nothing about poses, nor does what was wrong with it. If it comes back,
    that holds again.
    """

    def __init__(self, make: Callable[[], V]) -> None:
        self._make = make
        self._known: dict[str, V] = {}
        self._seen: dict[str, int] = {}
        """Stamp of its last scan, ns; the longest unseen first."""
        self.now = 0
        """ns; from when on a lidar is gone counts from here."""

    def see(self, lidar: str, stamp: int) -> None:
        """A scan of this stamp, ns, came from a lidar; nothing is known of it by that."""
        if lidar in self._known:
            del self._seen[lidar]
            self._seen[lidar] = stamp

    def of(self, lidar: str) -> V:
        """What is known of a lidar that sends scans now."""
        if lidar not in self._known:
            if len(self._known) == MOST:
                longest = next(iter(self._seen))
                del self._known[longest], self._seen[longest]
            self._known[lidar], self._seen[lidar] = self._make(), self.now
        return self._known[lidar]

    def get(self, lidar: str) -> V | None:
        """What is known of a lidar; None: nothing."""
        return self._known.get(lidar)

    def present(self) -> Iterator[tuple[str, V]]:
        """Those that sent a scan lately, in the order in which they first did."""
        for lidar, known in self._known.items():
            if abs(self.now - self._seen[lidar]) <= GONE_NS:
                yield lidar, known

    def all(self) -> Iterator[V]:
        """Also of lidars that are gone."""
        return iter(self._known.values())
