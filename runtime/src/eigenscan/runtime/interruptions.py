"""Notices times whose messages of other processes are lost, for a service that needs all of them."""

from __future__ import annotations

from collections.abc import Iterable

LEASE_S = 10.0
"""Zenoh's own: a process that stands still for longer loses its links, and all that waits in its sockets."""

SHOWN_S = 60.0
"""How long health reports one that has ended."""


class Interruptions:
    """Counts when every link was lost, or this process stood still. Nobody counts the messages themselves."""

    def __init__(self) -> None:
        self._routers: frozenset[str] = frozenset()
        self._links: frozenset[str] = frozenset()
        self._is_cut = False
        self._ended_s = SHOWN_S
        self.count = 0
        self.seconds = 0.0
        """How long they took in all, at most."""

    def look(self, routers: Iterable[str], peers: Iterable[str], since_s: float) -> None:
        """Call it about once a second, `since_s` after the last time, with whom there is a link to.

        Peers come and go: only a router's link is missed.
        """
        before, self._routers = self._routers, frozenset(routers)
        links, self._links = self._links, self._routers | frozenset(peers)
        was_cut, stood_still = self._is_cut, bool(links) and since_s > LEASE_S
        is_new = bool(before) and not links & self._links
        self._is_cut = (was_cut or is_new) and not self._links
        if (is_new or stood_still) and not was_cut:
            self.count += 1
        if is_new or was_cut or stood_still:
            self.seconds += since_s
            self._ended_s = 0.0
        else:
            self._ended_s += since_s

    @property
    def problem(self) -> str:
        """What is missing, as text; empty where nothing is, or if that was over SHOWN_S ago."""
        if self._is_cut:
            return "no link to the router: messages of others are missing"
        if self._ended_s < SHOWN_S:
            return f"messages of up to {self.seconds:.0f} s are missing: no link, or this process stood still"
        return ""
