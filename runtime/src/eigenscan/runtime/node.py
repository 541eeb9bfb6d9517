"""The shell around a core: session, inbox, liveliness, health, metrics, shutdown.

The core has a thread of its own. The main thread tells the service's health and answers signals,
so that both work while the core computes for long.
"""

from __future__ import annotations

import faulthandler
import math
import os
import sys
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TypeVar

import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.health import TWIN_HINT, WAITING, Monitor
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.keepsake import Keepsake
from eigenscan.runtime.logs import configure
from eigenscan.runtime.port import NoPort, Port
from eigenscan.runtime.session import open_meanwhile
from eigenscan.runtime.settings import ServiceSettings, SettingsError, load
from eigenscan.runtime.wake import Wake
from eigenscan.schemas.channels import HEALTH, Channel, ContractError
from eigenscan.schemas.envelope import Condition, Core, Envelope, nanoseconds
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.wire import decode

S = TypeVar("S", bound=ServiceSettings)

HEALTH_PERIOD_S = 1.0
CONDITION_PERIOD_S = 0.25
STOP_CORE_S = 1.0
"""What the core gets to end its present message and say what it holds back, when told to stop."""
CLOSE_S = 0.7
"""What the session gets to close: a neighbour may be slow to take a large answer."""
STOP_ALL_S = 1.9
"""After this a process that was told to stop is ended by force."""
WHOLE_SITE_SLACK = 16
"""Who hears a whole site may fall behind so many times farther, while a disk is busy, before it drops."""
EXIT_SETTINGS = 2
EXIT_CORE = 1


def main(
    service: str,
    kind: type[S],
    make_core: Callable[[S], Core],
    mode: str = "peer",
    *,
    whole_site: bool = False,
    make_port: Callable[[S], Port] | None = None,
) -> None:
    """Entry point of a service: reads settings, runs until SIGTERM or SIGINT, exits.

    `mode` is that of the Zenoh session where the settings name no configuration file. `whole_site`: also
    hears keys of the site that are not of the contract, to count them, and drops later than others.
    `make_port`: carries those channels of the core that are not of the contract.
    """
    wake = Wake()
    with wake.on_signals():
        settings = None
        try:
            settings = load(kind, service)
            port = make_port(settings) if make_port else None
            node = Node(
                service, settings, lambda: make_core(settings), mode, wake, whole_site=whole_site, port=port
            )
            code = node.run()
        except (SettingsError, ContractError, OSError, ValueError) as error:
            print(f"eigenscan-{service}: {error}", file=sys.stderr)
            code = EXIT_SETTINGS
        except BaseException:
            if settings is None:  # --help, or flags that are none: all is said
                raise
            traceback.print_exc()
            code = EXIT_CORE
    sys.stdout.flush()
    sys.stderr.flush()
    # all is closed; a last thread of Zenoh or of the core would abort the interpreter's own end
    os._exit(code)


class Node:
    """Runs one core on Zenoh. A message that the core fails on is counted and logged, not fatal."""

    def __init__(
        self,
        service: str,
        settings: ServiceSettings,
        make_core: Callable[[], Core],
        mode: str = "peer",
        wake: Wake | None = None,
        *,
        whole_site: bool = False,
        port: Port | None = None,
    ) -> None:
        self.service, self.settings = service, settings
        self._whole_site = whole_site
        self._make_core, self._mode = make_core, mode
        self._wake = wake or Wake()
        self._counts: Counter[str] = Counter()
        self._warned_at: dict[str, float] = {}
        self._told = (Health.STATUS_UNSPECIFIED, "")
        self._twins = 0
        self._log = configure(
            settings.log_level, settings.log_format, service=service, instance=settings.instance
        )
        self._monitor = Monitor(
            service, settings.instance, _package_version(service), settings=settings.told()
        )
        self._inbox = Inbox(WHOLE_SITE_SLACK if whole_site else 1)
        self._bus: Bus | None = None
        self._keepsake: Keepsake | None = None
        self._port = port or NoPort()
        self._fault: BaseException | None = None

    def stop(self) -> None:
        """Asks the node to end, from any thread."""
        self._wake.stop()

    def run(self) -> int:
        """Runs until stopped; gives the exit code. Raises what ended the core before that."""
        settings = self.settings
        if settings.metrics_port is not None:
            port = self._monitor.serve(settings.metrics_host, settings.metrics_port)
            self._log.info("metrics", url=f"http://{settings.metrics_host}:{port}/metrics")
        core = threading.Thread(target=self._run_core, name="core", daemon=True)
        core.start()
        self._tend(core)
        faulthandler.dump_traceback_later(STOP_ALL_S, exit=True)
        try:
            self._inbox.close()
            core.join(STOP_CORE_S)
            unfinished = core.is_alive()
            if self._bus:
                closing = threading.Thread(target=self._close, args=(self._bus,), name="close", daemon=True)
                closing.start()
                closing.join(CLOSE_S)
                unfinished = unfinished or closing.is_alive()
            self._monitor.close()
        finally:
            faulthandler.cancel_dump_traceback_later()
        if self._fault:
            raise self._fault
        self._log.info("stopped", unfinished=unfinished, **dict(self._counts))
        return EXIT_CORE if self._counts["finish_failed"] else 0

    def _tend(self, core: threading.Thread) -> None:
        """Tells the service's health once a second and at every change, until the end is asked for."""
        while not self._wake.stopping and core.is_alive():
            self._wake.wait(HEALTH_PERIOD_S)
            if self._bus:
                self._tell(self._bus)

    def _tell(self, bus: Bus) -> None:
        health = self._monitor.message()
        address = {
            "site": self.settings.site,
            "service": self.service,
            "instance": self.settings.instance,
        }
        bus.say(Envelope(HEALTH, address, health))
        if (health.status, health.detail) != self._told:
            self._told = (health.status, health.detail)
            self._log.info("status", status=Health.Status.Name(health.status), detail=health.detail)
        if bus.twins > self._twins:
            self._twins = bus.twins
            self._monitor.hear_twin()
            self._warn("duplicate_instance", hint=TWIN_HINT)

    def _run_core(self) -> None:
        try:
            opening = open_meanwhile(self.settings.zenoh, self._mode)
            core = self._make_core()
            bus = self._connect(core, opening.result())
            self._say(bus, core.start())
            self._log.info("ready", site=self.settings.site, robot=self.settings.robot)
            self._loop(bus, core)
        except BaseException as error:
            self._fault = error
        self._wake.set()

    def _connect(self, core: Core, session: zenoh.Session) -> Bus:
        settings = self.settings
        address = {"site": settings.site}
        if settings.robot != "*":
            address["robot"] = settings.robot
        bus = self._bus = Bus(session)
        apart = self._port.channels
        hears = [channel for channel in core.hears if channel not in apart]
        bus.offer([channel for channel in core.says if channel not in apart], address)
        if self._whole_site and settings.robot == "*":
            bus.listen_all(hears, f"{settings.site}/**", self._inbox)
        else:
            bus.listen(hears, address, self._inbox, self._remember(hears))
        bus.announce(settings.site, self.service, settings.instance)
        self._port.open(self._inbox)
        return bus

    def _remember(self, hears: Sequence[Channel]) -> list[Arrival]:
        """Lets the core hear again what was kept on disk; gives it."""
        if self.settings.keep is None:
            return []
        self._keepsake = Keepsake(self.settings.keep)
        known = [sample for sample in self._keepsake.read(self.settings.site) if sample.channel in hears]
        for sample in known:
            self._inbox.put(sample.channel, sample.key, sample.payload, sample.encoding)
        return known

    def _keep(self, sample: Arrival) -> None:
        if self._keepsake is None:
            return
        try:
            self._keepsake.put(sample)
        except OSError as error:
            self._set_aside("not_kept", sample.key, error)

    def _close(self, bus: Bus) -> None:
        self._port.close()
        bus.close()

    def _loop(self, bus: Bus, core: Core) -> None:
        due = 0.0
        while not self._wake.stopping:
            if time.monotonic() >= due:
                if self._monitor.turn(self._condition(core)):
                    self._wake.set()
                due = time.monotonic() + CONDITION_PERIOD_S
            arrival = self._inbox.take(CONDITION_PERIOD_S)
            if arrival is not None:
                self._handle(bus, core, arrival)
        try:
            self._say(bus, core.finish())
        except Exception as error:
            self._set_aside("finish_failed", "", error, trace=True)

    def _condition(self, core: Core) -> Condition:
        counters = dict(self._counts)
        dropped = self._inbox.dropped
        if dropped.get("foreign_key", 0) > counters.get("foreign_key", 0):
            self._counts["foreign_key"] = counters["foreign_key"] = dropped["foreign_key"]
            self._warn("foreign_key", count=dropped["foreign_key"])
        counters |= {f"dropped_{name}": count for name, count in dropped.items()}
        counters[WAITING] = len(self._inbox)
        try:
            own = core.condition()
        except Exception as error:
            self._set_aside("core_failed", "", error, trace=True)
            return Condition(Health.STATUS_DEGRADED, f"the core cannot tell its condition: {error}", counters)
        return Condition(own.status, own.detail, dict(own.counters) | counters)

    def _handle(self, bus: Bus, core: Core, arrival: Arrival) -> None:
        channel = arrival.channel
        address = channel.parse(arrival.key)
        if address is None:
            self._set_aside("foreign_key", arrival.key, None)
            return
        try:
            message = decode(channel, arrival.payload, arrival.encoding)
        except ContractError as error:
            self._set_aside("undecodable", arrival.key, error)
            return
        self._counts[f"heard_{channel.name}"] += 1
        with self._monitor.handling.labels(channel.name).time():
            try:
                self._say(bus, core.handle(Envelope(channel, address, message)))
            except Exception as error:
                # the shell outlives a fault of the core: the next scan may be fine
                if not self._wake.stopping:
                    self._set_aside("core_failed", arrival.key, error, trace=True)
        if channel.qos.latched:
            self._keep(arrival)
        if channel.qos.rate_hz:  # what has a rate has a stamp
            self._monitor.dealt_with(channel.name, nanoseconds(message.timestamp))  # type: ignore[attr-defined]

    def _say(self, bus: Bus, envelopes: Iterable[Envelope]) -> None:
        for envelope in envelopes:
            (self._port if envelope.channel in self._port.channels else bus).say(envelope)
            self._counts[f"said_{envelope.channel.name}"] += 1

    def _set_aside(self, reason: str, key: str, error: BaseException | None, trace: bool = False) -> None:
        self._counts[reason] += 1
        self._warn(
            reason,
            key=key,
            error=str(error) if error else "",
            count=self._counts[reason],
            exc_info=error if trace else None,
        )

    def _warn(self, reason: str, **context: object) -> None:
        """Logs a warning, at most once a second for each reason."""
        now = time.monotonic()
        if now - self._warned_at.get(reason, -math.inf) >= 1.0:
            self._warned_at[reason] = now
            self._log.warning(reason, **context)


def _package_version(service: str) -> str:
    for distribution in (f"eigenscan-{service}", "eigenscan-runtime"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return ""
