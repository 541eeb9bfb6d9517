"""A process's session, as the runtime's Bus uses zenoh.Session."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import zenoh
from eigenscan.runtime.intake import Intake
from eigenscan.schemas.channels import find
from eigenscan.workbench.simtest.agenda import MachineClock

if TYPE_CHECKING:
    from eigenscan.workbench.simtest.network import Network
    from eigenscan.workbench.simtest.process import Process

expression = lru_cache(maxsize=65536)(zenoh.KeyExpr)
channel_of = lru_cache(maxsize=65536)(find)


@lru_cache(maxsize=65536)
def _counted_as(key: str) -> str:
    found = channel_of(key)
    return found[0].name if found else "foreign_key"


class Bytes(bytes):
    """A payload."""

    def to_bytes(self) -> bytes:
        """As Zenoh's."""
        return self


NOTHING = Bytes()


@dataclass(frozen=True, order=True)
class Timestamp:
    """Time and session."""

    time: int
    own: str

    def get_id(self) -> str:
        """Whose it is."""
        return self.own


class Sample(NamedTuple):
    """What a subscriber gets."""

    key_expr: str
    payload: Bytes = NOTHING
    encoding: Any = ""
    timestamp: Timestamp | None = None
    kind: Any = zenoh.SampleKind.PUT


@dataclass(frozen=True)
class Reply:
    """What a query gets."""

    ok: Sample | None
    err: str = ""


class Declared:
    """A subscriber, a queryable or a token, until it is undeclared."""

    def __init__(self, session: Session, key: str, callback: Any = None, **more: Any) -> None:
        if isinstance(callback, zenoh.handlers.Callback):  # in whose thread makes no difference here
            callback = callback.callback.__wrapped__  # type: ignore[attr-defined]
        self.session, self.key, self.callback, self.more = session, key, callback, more
        self.expression = expression(key)
        self.seen: set[str] = set()
        """Of a subscriber to tokens: those that are there."""
        self.waiting: deque[Sample] = deque()
        """Of a subscriber without a callback: what `try_recv` takes."""
        self.fills_inbox = isinstance(getattr(callback, "__self__", None), Intake)
        self.is_patient = isinstance(callback, zenoh.handlers.RingChannel)
        """Whether what arrives waits until the service looks, and wakes nobody at once."""
        if self.is_patient:
            self.callback = self.waiting.append

    def try_recv(self) -> Sample | None:
        """The oldest sample that waits; only now it is in the inbox."""
        if not self.waiting:
            return None
        sample = self.waiting.popleft()
        self.session.note_arrived(sample.key_expr)
        return sample

    def undeclare(self) -> None:
        """Ends it."""
        self.session.network.forget(self)


class Publisher:
    """Puts on one key."""

    def __init__(self, session: Session, key: str, reported: Any, *, block: bool) -> None:
        self._session, self._key, self._encoding, self._block = session, key, reported, block

    def put(self, payload: bytes, timestamp: Timestamp | None = None) -> None:
        """Publishes."""
        if not self._session.is_open:
            return
        translated = self._session.translate(self._key, payload)
        if translated is not None:
            sample = Sample(self._key, Bytes(translated), self._encoding, timestamp)
            self._session.network.publish(self._session, sample, block=self._block)

    def undeclare(self) -> None:
        """Nothing to undo."""


class Query:
    """At a queryable."""

    def __init__(self, session: Session, key: str, payload: bytes | None, answer: Callable[[Reply], None]):
        self.session, self.key_expr = session, expression(key)
        self.payload = None if payload is None else Bytes(payload)
        self._answer = answer

    def __enter__(self) -> Query:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def reply(self, key: Any, payload: bytes, encoding: Any = "", timestamp: Any = None, **_: Any) -> None:
        """Sends an answer."""
        translated = self.session.translate(str(key), payload)
        if translated is not None:
            self._answer(Reply(Sample(str(key), Bytes(translated), encoding, timestamp)))

    def reply_err(self, payload: str) -> None:
        """Sends an error."""
        self._answer(Reply(None, payload))


class Session:
    """One process's, as the runtime's Bus uses zenoh.Session."""

    def __init__(self, network: Network, machine: str, number: int, clock: MachineClock) -> None:
        self.network, self.machine, self._clock = network, machine, clock
        self.name = f"{number:08x}"
        self.is_open = True
        self.is_silent = False
        """It stands, but nothing arrives any more."""
        self.arrived: Counter[str] = Counter()
        """What was handed to the inbox, by channel."""
        self.owner: Process | None = None
        """The service's process; None: a driver or a stranger."""
        self.translate: Callable[[str, bytes], bytes | None] = lambda _key, payload: payload
        """What a service of another release publishes instead; None: nothing."""
        self._stamped = 0
        self.info = self

    def note_arrived(self, key: str) -> None:
        """Counts what is handed to the inbox."""
        self.arrived[_counted_as(key)] += 1

    def zid(self) -> str:
        """Its name."""
        return self.name

    def routers_zid(self) -> list[str]:
        """None: peers are enough to show a link."""
        return []

    def peers_zid(self) -> list[str]:
        """Whom it is linked to: those of its machine always."""
        return [each.name for each in self.network.sessions if each is not self]

    def is_closed(self) -> bool:
        """Whether it was closed."""
        return not self.is_open

    def new_timestamp(self) -> Timestamp:
        """Later than all before it."""
        self._stamped = max(self._stamped + 1, self._clock.time_ns())
        return Timestamp(self._stamped, self.name)

    def declare_publisher(
        self, key: str, encoding: Any = "", congestion_control: Any = None, **_: Any
    ) -> Any:
        """Of one key."""
        block = congestion_control == zenoh.CongestionControl.BLOCK
        return Publisher(self, key, str(encoding), block=block)

    def declare_subscriber(self, key: str, callback: Any, allowed_origin: Any = zenoh.Locality.ANY) -> Any:
        """To all keys that fit."""
        remote = allowed_origin == zenoh.Locality.REMOTE
        return self.network.subscribe(Declared(self, key, callback, remote=remote))

    def declare_queryable(self, key: str, callback: Any, **_: Any) -> Any:
        """For all keys that fit."""
        return self.network.offer(Declared(self, key, callback))

    def liveliness(self) -> Session:
        """Tokens."""
        return _Liveliness(self)  # type: ignore[return-value]

    def get(
        self, selector: str, handler: Any, payload: bytes | None = None, timeout: float = 10.0, **_: Any
    ) -> None:
        """Asks all who answer."""
        self.network.ask(self, str(selector), handler, payload, timeout)

    def close(self) -> None:
        """Ends all of it."""
        self.network.close(self)


class _Liveliness:
    def __init__(self, session: Session) -> None:
        self._session = session

    def declare_token(self, key: str) -> Declared:
        return self._session.network.show(Declared(self._session, key))

    def declare_subscriber(self, key: str, callback: Any, **_: Any) -> Declared:
        return self._session.network.watch(Declared(self._session, key, callback))

    def get(self, _key: str, handler: Callable[[Reply], None], timeout: float) -> None:
        """A router answers at once, which a session that receives nothing does not learn."""
        self._session.network.time_out(self._session, handler, timeout)
