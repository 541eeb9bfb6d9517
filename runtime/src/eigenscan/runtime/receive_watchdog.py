"""Notices a session that stands but is given nothing any more, of whatever anybody publishes.

Seen once under a load of 60 to 100: counters frozen for minutes, data unread in the process's socket, more
waiting in the router, and health OK. Zenoh's issues 2806 and 1886 tell of relatives.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import zenoh
from eigenscan.runtime.link_watchdog import is_linked
from eigenscan.schemas.channels import ALIVE_TEMPLATE, HEALTH

EXIT_DEAF = 75
"""Exit code of a process that ends because nothing arrives, to be started again (sysexits.h: EX_TEMPFAIL)."""


class ReceiveWatchdog:
    """Whether the health of other services of one instance name still arrives, once a second by the contract.

    What is published here does not count: it need not leave the process. Nothing is expected of a service
    whose token is gone: a session that still receives is told so. Nor is it while there is no link at all.
    """

    def __init__(self, patience: int) -> None:
        """`patience`: ticks without a word of anybody, after which the session is deaf."""
        self._patience = patience
        self._lock = threading.Lock()
        self._alive: set[str] = set()
        self._speaking: set[str] = set()
        self._has_heard = False
        self._silent = 0

    def attach(self, session: zenoh.Session, site: str, service: str, instance: str) -> list[Any]:
        """Listens in `session`; gives what is declared. `service` is this one's own name."""
        own, address = service, {"site": site, "instance": instance}

        def on_health(sample: Any) -> None:
            self._hear(str(sample.key_expr).split("/")[-2], own)

        def on_token(token: Any) -> None:
            self._see(str(token.key_expr).split("/")[-3], own, there=token.kind == zenoh.SampleKind.PUT)

        tokens = ALIVE_TEMPLATE.format(**address, service="*", contract="*")
        return [
            session.declare_subscriber(
                HEALTH.selector(address), on_health, allowed_origin=zenoh.Locality.REMOTE
            ),
            session.liveliness().declare_subscriber(tokens, on_token, history=True),
        ]

    def is_lost(self, session: zenoh.Session) -> bool:
        """Told once a second; True from when nothing has come for `patience` of these calls.

        Calls are counted, not seconds: a process that gets no turn is not deaf.
        """
        with self._lock:
            heard, self._has_heard = self._has_heard, False
            expected = bool(self._alive & self._speaking)
        linked = False
        with contextlib.suppress(RuntimeError, zenoh.ZError):  # another thread closes it just now
            linked = is_linked(session)
        self._silent = 0 if heard or not expected or not linked else self._silent + 1
        return self._silent >= self._patience

    def _hear(self, service: str, own: str) -> None:
        if service != own:
            with self._lock:
                self._has_heard = True
                self._speaking.add(service)

    def _see(self, service: str, own: str, *, there: bool) -> None:
        if service == own:
            return
        with self._lock:
            if there:
                self._alive.add(service)
            else:  # a word as good as another
                self._has_heard = True
                self._alive.discard(service)
                self._speaking.discard(service)
