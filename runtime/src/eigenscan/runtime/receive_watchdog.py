"""Notices an open session that no longer receives anything.

Seen once under a load of 60 to 100: counters frozen for minutes, data unread in the process's socket, more
waiting in the router, and health OK. Zenoh's issues 2806 and 1886 are similar.
"""

from __future__ import annotations

import contextlib
import threading
from typing import Any

import zenoh
from eigenscan.runtime.callback import at_once
from eigenscan.runtime.link_watchdog import is_linked
from eigenscan.schemas.channels import ALIVE_TEMPLATE, HEALTH

EXIT_DEAF = 75
"""Exit code of a process that ends because nothing arrives, to be started again (sysexits.h: EX_TEMPFAIL)."""

UNANSWERED = 2


class ReceiveWatchdog:
    """Watches whether health of other services of one instance name arrives.

    The contract requires one message a second.
    Messages of this process do not count, because they need not leave it. No message is expected from a
    service whose token is gone, nor while there is no link. Where none is expected at all, it queries the
    tokens, which a router always answers.
    """

    def __init__(self, patience: int) -> None:
        """`patience`: calls of `is_lost` without any message, after which the session counts as lost."""
        self._patience = patience
        self._query_every = max(2, patience // 2)
        self._tokens = ""
        self._alone = 0
        self._timed_out = False
        self._unanswered = 0
        self._lock = threading.Lock()
        self._alive: set[str] = set()
        self._speaking: set[str] = set()
        self._has_received = False
        self._silent = 0

    def attach(self, session: zenoh.Session, site: str, service: str, instance: str) -> list[Any]:
        """Subscribes in `session`; returns the subscribers. `service`: this service's own name."""
        own, address = service, {"site": site, "instance": instance}

        def on_health(sample: Any) -> None:
            self._receive(str(sample.key_expr).split("/")[-2], own)

        def on_token(token: Any) -> None:
            self._see(str(token.key_expr).split("/")[-3], own, there=token.kind == zenoh.SampleKind.PUT)

        self._tokens = ALIVE_TEMPLATE.format(**address, service="*", contract="*")
        return [
            session.declare_subscriber(
                HEALTH.selector(address), at_once(on_health), allowed_origin=zenoh.Locality.REMOTE
            ),
            session.liveliness().declare_subscriber(self._tokens, at_once(on_token), history=True),
        ]

    def is_lost(self, session: zenoh.Session) -> bool:
        """Whether nothing arrived during the last `patience` calls, or UNANSWERED queries in a row timed out.

        Call it once a second. Calls are counted, not seconds, because a process that gets no CPU time is not
        lost.
        """
        with self._lock:
            received, self._has_received = self._has_received, False
            expected = bool(self._alive & self._speaking)
        linked = False
        with contextlib.suppress(RuntimeError, zenoh.ZError):  # another thread closes it just now
            linked = is_linked(session)
            if received or expected or not linked:
                self._alone = self._unanswered = 0
            else:
                self._query(session)
        self._silent = 0 if received or not expected or not linked else self._silent + 1
        return self._silent >= self._patience or self._unanswered >= UNANSWERED

    def _query(self, session: zenoh.Session) -> None:
        """Queries the tokens now and then, and counts the queries in a row that nobody answered."""
        self._alone += 1
        if self._alone % self._query_every:
            return
        self._unanswered = self._unanswered + 1 if self._timed_out else 0
        self._timed_out = False
        session.liveliness().get(self._tokens, self._on_reply, timeout=0.8 * self._query_every)

    def _on_reply(self, reply: Any) -> None:
        """A token, or the error of a query that timed out."""
        self._timed_out = self._timed_out or reply.ok is None

    def _receive(self, service: str, own: str) -> None:
        if service != own:
            with self._lock:
                self._has_received = True
                self._speaking.add(service)

    def _see(self, service: str, own: str, *, there: bool) -> None:
        if service == own:
            return
        with self._lock:
            if there:
                self._alive.add(service)
            else:  # the end of a token is a message too
                self._has_received = True
                self._alive.discard(service)
                self._speaking.discard(service)
