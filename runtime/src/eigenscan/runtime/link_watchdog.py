"""Notices a link to another router that is up but passes nothing.

If a router was out of reach for longer than its lease, Zenoh 1.10 closes the old link a second time, some
seconds after the new link is up, and forgets the new one. The TCP connection stays open on both sides, but no
message passes it.
"""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.runtime.configured import stated

DEAD_S = 20.0
"""Twice the time that Zenoh allows from a connection to a link, s."""
LOOK_EVERY_S = 1.0
_ESTABLISHED = "01"
_TABLES = ("/proc/self/net/tcp", "/proc/self/net/tcp6")


def await_dead_link(config: Path, session: zenoh.Session) -> bool:
    """Waits for a TCP connection to an endpoint of `config` that has no link for DEAD_S; then True.

    Returns False if the session ends first.
    """
    ports = set(ports_of(endpoints_in(config)))
    since = time.monotonic()
    while time.monotonic() - since < DEAD_S:
        time.sleep(LOOK_EVERY_S)
        try:
            if session.is_closed():
                return False
        except RuntimeError:  # another thread closes it just now
            return False
        if session.info.routers_zid() or not is_connected(ports):
            since = time.monotonic()
    return True


def is_linked(session: zenoh.Session) -> bool:
    """Whether the session has any link. Raises RuntimeError if another thread closes it meanwhile."""
    return bool(session.info.routers_zid() or session.info.peers_zid())


def endpoints_in(config: Path | None) -> list[str]:
    """Endpoints that a configuration connects to; none if it cannot be read."""
    return list(endpoints_of(stated(config, "connect/endpoints")))


def endpoints_of(given: Any) -> Iterator[str]:
    """Zenoh's endpoints as a configuration states them: one, a list, or lists by mode."""
    if isinstance(given, str):
        yield given
    elif isinstance(given, dict):
        yield from endpoints_of(list(given.values()))
    elif isinstance(given, list):
        for one in given:
            yield from endpoints_of(one)


def ports_of(given: Any) -> Iterator[int]:
    """Their ports."""
    for endpoint in endpoints_of(given):
        found = re.search(r":(\d+)(?:[?#]|$)", endpoint)
        if found:
            yield int(found[1])


def is_connected(ports: set[int]) -> bool:
    """Whether this process has an established TCP connection to one of these ports.

    False outside of Linux.
    """
    own = _own_sockets()
    for table in map(Path, _TABLES):
        if not table.exists():
            continue
        for line in table.read_text().splitlines()[1:]:
            words = line.split()
            remote, state, inode = words[2], words[3], words[9]
            if state == _ESTABLISHED and int(remote.rpartition(":")[2], 16) in ports and inode in own:
                return True
    return False


def _own_sockets() -> set[str]:
    """Inodes of this process's sockets."""
    found = set()
    for link in Path("/proc/self/fd").glob("*"):
        try:
            name = str(link.readlink())
        except OSError:  # closed meanwhile
            continue
        if name.startswith("socket:["):
            found.add(name[8:-1])
    return found
