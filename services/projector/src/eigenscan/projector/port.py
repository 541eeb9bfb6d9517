"""Queries on {site}/localize: one after another into the inbox, never so many that scans wait for them."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import zenoh
from eigenscan.projector.channels import LOCALIZE_ANSWERED, LOCALIZE_ASKED, LOCALIZE_REFUSED
from eigenscan.projector.options import ProjectorOptions
from eigenscan.runtime.inbox import Inbox
from eigenscan.schemas.channels import LOCALIZE_TEMPLATE, MOST_ASKED_BYTES, Channel, ContractError
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import decode, encode, encoding
from google.protobuf.wrappers_pb2 import StringValue

WAITING = 8
"""Queries that wait at most; a further one is refused at once."""
PATIENCE_S = 10.0
"""Zenoh's default timeout of a query, after which nobody waits for the answer."""


@dataclass
class _Open:
    """A query that was not answered yet."""

    query: Any
    payload: bytes
    came: float  # s, monotonic
    answered: threading.Event = field(default_factory=threading.Event)

    def reply(self, payload: bytes, encoded: str) -> None:
        with self.query, contextlib.suppress(zenoh.ZError):  # the asker is gone
            self.query.reply(self.query.key_expr, payload, encoding=zenoh.Encoding(encoded))
        self.answered.set()

    def refuse(self, reason: str) -> None:
        with self.query, contextlib.suppress(zenoh.ZError):
            self.query.reply_err(reason)
        self.answered.set()


class LocalizePort:
    """Gives the core one query at a time, then waits until they took no more than their share of time."""

    channels: tuple[Channel, ...] = (LOCALIZE_ASKED, LOCALIZE_ANSWERED, LOCALIZE_REFUSED)

    def __init__(self) -> None:
        self._session: zenoh.Session | None = None
        self._key, self._share, self._complete = "", 0.0, True
        self._waiting: deque[_Open] = deque()
        self._present: dict[str, _Open] = {}
        self._changed = threading.Condition()
        self._closed = False
        self._declared: Any = None

    def attend(self, options: ProjectorOptions, session: zenoh.Session) -> None:
        """Takes the session that the service has."""
        self._session, self._share = session, options.localize_share
        self._key = LOCALIZE_TEMPLATE.format(site=options.site)
        self._complete = options.share[1] == 1  # each projector of a divided site answers for its own part

    def open(self, inbox: Inbox) -> None:
        """Answers from now on."""
        if self._session is None or not self._share:
            return
        threading.Thread(target=self._feed, args=(inbox,), name="localize", daemon=True).start()
        self._declared = self._session.declare_queryable(self._key, self._on_query, complete=self._complete)

    def publish(self, envelope: Envelope) -> None:
        """Answers the query that is at the core."""
        present = self._present.get(envelope.address["query"])
        if present is None:
            return
        if envelope.channel is LOCALIZE_REFUSED:
            present.refuse(envelope.open(StringValue).value)
        else:
            present.reply(encode(envelope.message), encoding(LOCALIZE_ANSWERED))

    def close(self) -> None:
        """Refuses the waiting queries."""
        with self._changed:
            self._closed = True
            left = [*self._waiting, *self._present.values()]
            self._waiting.clear()
            self._changed.notify_all()
        for one in left:
            if not one.answered.is_set():
                one.refuse("the projector stops")
        if self._declared is not None:
            with contextlib.suppress(zenoh.ZError):  # the link may be gone already
                self._declared.undeclare()

    def _on_query(self, query: Any) -> None:
        payload = query.payload.to_bytes() if query.payload is not None else b""
        one = _Open(query, payload, time.monotonic())
        try:
            if not payload:
                raise ContractError("the query has no payload: give an eigenscan.LocalizeQuery")
            if len(payload) > MOST_ASKED_BYTES:
                raise ContractError(f"{len(payload)} bytes; at most {MOST_ASKED_BYTES}")
            decode(LOCALIZE_ASKED, payload, str(query.encoding) if query.encoding is not None else None)
        except ContractError as error:
            one.refuse(str(error))
            return
        with self._changed:
            busy = self._closed or len(self._waiting) >= WAITING
            if not busy:
                self._waiting.append(one)
                self._changed.notify()
        if busy:
            one.refuse(f"busy: {WAITING} queries wait already; ask again later, or raise localize_share")

    def _feed(self, inbox: Inbox) -> None:
        number = 0
        while one := self._next():
            began = time.monotonic()
            if began - one.came > PATIENCE_S:
                one.refuse(f"busy: not reached within {PATIENCE_S:g} s; raise localize_share")
                continue
            number += 1
            name = str(number)
            self._present[name] = one
            key = LOCALIZE_ASKED.key({"query": name})
            inbox.put(LOCALIZE_ASKED, key, one.payload, encoding(LOCALIZE_ASKED))
            if not one.answered.wait(PATIENCE_S):
                one.refuse(f"no answer within {PATIENCE_S:g} s: see the projector's health")
            del self._present[name]
            self._rest((time.monotonic() - began) * (1.0 / self._share - 1.0))

    def _next(self) -> _Open | None:
        """The query that waits longest; None after the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._waiting)
            return None if self._closed else self._waiting.popleft()

    def _rest(self, seconds: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._closed, min(seconds, PATIENCE_S))
