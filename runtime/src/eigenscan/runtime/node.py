"""The shell around a core: session, inbox, liveliness, health, metrics, shutdown."""

from __future__ import annotations

import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from importlib.metadata import version
from types import FrameType
from typing import TypeVar

from eigenscan.runtime.bus import Bus, open_session
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.logs import configure
from eigenscan.runtime.settings import ServiceSettings, SettingsError, load
from eigenscan.schemas.channels import HEALTH, ContractError
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode

S = TypeVar("S", bound=ServiceSettings)

HEALTH_PERIOD_S = 1.0
EXIT_SETTINGS = 2
EXIT_CORE = 1


def main(service: str, kind: type[S], make_core: Callable[[S], Core]) -> None:
    """Entry point of a service: reads settings, runs until SIGTERM or SIGINT, exits."""
    try:
        settings = load(kind, service)
        core = make_core(settings)
        sys.exit(Node(service, settings, core).run())
    except (SettingsError, ContractError, OSError, ValueError) as error:
        print(f"eigenscan-{service}: {error}", file=sys.stderr)
        sys.exit(EXIT_SETTINGS)


class Node:
    """Runs one core on Zenoh. A message that the core fails on is counted and logged, not fatal."""

    def __init__(self, service: str, settings: ServiceSettings, core: Core) -> None:
        self.service, self.settings, self.core = service, settings, core
        self._stop = threading.Event()
        self._counts: Counter[str] = Counter()
        self._said_at: dict[str, float] = {}
        self._log = configure(
            settings.log_level, settings.log_format, service=service, instance=settings.instance
        )
        self._monitor = Monitor(service, settings.instance, version(f"eigenscan-{service}"))
        self._inbox = Inbox()

    def stop(self, _signum: int = 0, _frame: FrameType | None = None) -> None:
        """Asks the loop to end; it does within one message."""
        self._stop.set()

    def run(self) -> int:
        """Runs until stopped; gives the exit code."""
        signal.signal(signal.SIGTERM, self.stop)
        signal.signal(signal.SIGINT, self.stop)
        settings = self.settings
        address = {"site": settings.site}
        if settings.robot != "*":
            address["robot"] = settings.robot
        if settings.metrics_port is not None:
            port = self._monitor.serve(settings.metrics_host, settings.metrics_port)
            self._log.info("metrics", url=f"http://{settings.metrics_host}:{port}/metrics")
        with Bus(open_session(settings.zenoh)) as bus:
            bus.offer(self.core.says, address)
            bus.listen(self.core.hears, address, self._inbox)
            bus.announce(settings.site, self.service, settings.instance)
            self._log.info("ready", site=settings.site, robot=settings.robot)
            self._say(bus, self.core.start())
            self._loop(bus)
            self._say(bus, self.core.finish())
        self._monitor.close()
        self._log.info("stopped", **dict(self._counts))
        return 0

    def _loop(self, bus: Bus) -> None:
        due = 0.0
        while not self._stop.is_set():
            arrival = self._inbox.take(timeout=0.1)
            if arrival is not None:
                self._handle(bus, arrival)
            now = time.monotonic()
            if now >= due:
                changed = self._monitor.turn(self._condition())
                health = self._monitor.message()
                self._say(bus, [Envelope(HEALTH, self._health_address(), health)])
                if changed:
                    self._log.info("status", status=Health.Status.Name(health.status), detail=health.detail)
                due = now + HEALTH_PERIOD_S

    def _health_address(self) -> dict[str, str]:
        return {
            "site": self.settings.site,
            "service": self.service,
            "instance": self.settings.instance,
        }

    def _condition(self) -> Condition:
        own = self.core.condition()
        counters = dict(own.counters) | dict(self._counts)
        counters |= {f"dropped_{name}": count for name, count in self._inbox.dropped.items()}
        return Condition(own.status, own.detail, counters)

    def _handle(self, bus: Bus, arrival: Arrival) -> None:
        try:
            message = decode(arrival.channel, arrival.payload, arrival.encoding)
        except ContractError as error:
            self._set_aside("undecodable", arrival.key, error)
            return
        address = arrival.channel.parse(arrival.key)
        if address is None:
            self._set_aside("foreign_key", arrival.key, None)
            return
        self._counts[f"heard_{arrival.channel.name}"] += 1
        with self._monitor.handling.labels(arrival.channel.name).time():
            try:
                self._say(bus, self.core.handle(Envelope(arrival.channel, address, message)))
            except Exception as error:
                # the shell outlives a fault of the core: the next scan may be fine
                self._set_aside("core_failed", arrival.key, error, trace=True)

    def _set_aside(self, reason: str, key: str, error: BaseException | None, trace: bool = False) -> None:
        self._counts[reason] += 1
        now = time.monotonic()
        if now - self._said_at.get(reason, -1.0) >= 1.0:
            self._said_at[reason] = now
            self._log.warning(
                reason,
                key=key,
                error=str(error) if error else "",
                count=self._counts[reason],
                exc_info=error if trace else None,
            )

    def _say(self, bus: Bus, envelopes: Iterable[Envelope]) -> None:
        for envelope in envelopes:
            bus.say(envelope)
            self._counts[f"said_{envelope.channel.name}"] += 1
