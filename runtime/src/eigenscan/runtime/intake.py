"""Filters Zenoh's samples for an inbox: keys of the contract, and of latched keys only newer samples."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any

import zenoh
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.latched_cache import DIGEST_BYTES, digest
from eigenscan.schemas.channels import Channel, find
from eigenscan.schemas.wire import encoding
from google.protobuf.message import Message

MOST_LISTED = 2**16
"""Samples that one may hold: a region of a site each. A stranger's list may be of any length."""
MOST_GONE = 1000
"""Sessions that are known to have ended. A stranger's tokens may come and go without end."""


class Intake:
    """Puts samples into an inbox; of a latched key only samples newer than the last."""

    def __init__(self, channels: Sequence[Channel], inbox: Inbox, known: Iterable[Arrival] = ()) -> None:
        self._names = {channel.name for channel in channels}
        self._held = {
            sample.key: digest(sample.payload) for sample in known if sample.channel.name in self._names
        }
        self._inbox = inbox
        self._newest: dict[str, Any] = {}  # zenoh.Timestamp; its stub lacks the comparison
        self._gone: deque[str] = deque(maxlen=MOST_GONE)
        """Sessions whose token has ended."""
        self._preferred: set[str] = set()
        """Sessions whose samples were held against an older answer of another one."""
        self._lock = threading.Lock()
        self.ask_again: dict[str, Callable[[], None]] = {}
        """By a latched channel's name: queries all who publish it now."""

    def digests(self) -> list[bytes]:
        """Digests of the newest samples of latched keys, for a query's list of held samples."""
        with self._lock:
            return list(self._held.values())

    def on_token(self, session: str, *, stands: bool) -> bool:
        """A session that answers queries came, or went; whether to query all who publish now."""
        with self._lock:
            if session in self._gone:
                self._gone.remove(session)
            if not stands:
                self._gone.append(session)
            return stands or session in self._preferred  # what was refused for its sake counts now

    def on_sample(self, sample: Any) -> None:
        """Takes a live sample."""
        if self._inbox.wakes:
            self._inbox.sort()
            self.take_live(sample)
        else:
            self._inbox.put_unsorted(self.take_live, sample)

    def take_live(self, sample: Any, time: int | None = None) -> None:
        """Takes a live sample that arrived at `time`, ns since the epoch; by default now."""
        self._take(sample, live=True, time=time)

    def on_reply(self, reply: Any) -> None:
        """Takes a sample that a publisher held, or counts a missing answer."""
        if reply.ok is not None:
            self._inbox.sort()
            self._take(reply.ok, live=False)
        else:
            self._inbox.drop("unanswered")

    def on_message(self, channel: Channel, key: str, message: Message, payload: bytes, stamp: Any) -> None:
        """Takes a message of another service of this process; `stamp`: Zenoh's, if latched."""
        if channel.name in self._names:
            self._inbox.sort()
            self._put(channel, key, payload, encoding(channel), stamp, live=True, message=message)

    def _take(self, sample: Any, live: bool, time: int | None = None) -> None:
        key = str(sample.key_expr)
        channel = _channel_of(key)
        if channel is None or channel.name not in self._names:
            self._inbox.drop("foreign_key")
        elif sample.kind != zenoh.SampleKind.PUT:
            self._inbox.drop("deletion")
        else:
            payload, declared = sample.payload.to_bytes(), str(sample.encoding)
            self._put(channel, key, payload, declared, sample.timestamp, live=live, time=time)

    def _put(
        self,
        channel: Channel,
        key: str,
        payload: bytes,
        declared: str,
        stamp: Any,
        *,
        live: bool,
        message: Message | None = None,
        time: int | None = None,
    ) -> None:
        if not channel.qos.latched:
            self._inbox.put(channel, key, payload, declared, message, time)
            return
        with self._lock:  # held during the put, so that this sample cannot overtake a newer one
            before = self._newest.get(key)
            if self._is_news(key, stamp, live):
                self._inbox.put(channel, key, payload, declared, message, time)
                self._held[key] = digest(payload)
        of_other = live and before and stamp and before.get_id() != stamp.get_id()
        if of_other and (stamp < before or str(stamp.get_id()) in self._gone):
            # its clock is behind, or it is gone and its sample came late: only who is there answers
            self.ask_again.get(channel.name, _nobody)()

    def _is_news(self, key: str, stamp: Any, live: bool) -> bool:
        """Whether a sample is newer than the last of its key.

        Clocks of two publishers may differ, so a live sample of another publisher always counts as newer, and
        so does its answer once the former publisher is gone.
        """
        if stamp is None:
            return True
        held = self._newest.get(key)
        if held is not None and stamp <= held:
            if held.get_id() == stamp.get_id():
                return False
            holder = str(held.get_id())
            if not live and holder not in self._gone:
                self._preferred.add(holder)
                return False
        self._newest[key] = stamp
        return True


def _nobody() -> None:
    """Nobody to ask."""


def digests_in(payload: Any) -> frozenset[bytes]:
    """Digests that a query's payload lists as held; none where they are more than anybody holds."""
    known = payload is not None and len(payload) <= MOST_LISTED * DIGEST_BYTES
    listed = payload.to_bytes() if known else b""
    return frozenset(listed[i : i + DIGEST_BYTES] for i in range(0, len(listed), DIGEST_BYTES))


@lru_cache(maxsize=65536)
def _channel_of(key: str) -> Channel | None:
    found = find(key)
    return found[0] if found else None
