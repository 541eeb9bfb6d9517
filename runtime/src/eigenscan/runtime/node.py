"""The shell around a core: session, inbox, liveliness, health, metrics, shutdown.

The core has a thread of its own. The main thread tells the service's health and answers signals,
so that both work while the core computes for long.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import Any, TypeVar

import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.counters import Counters
from eigenscan.runtime.health import TWIN_HINT, Monitor
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.latched_cache import LatchedCache
from eigenscan.runtime.logs import configure
from eigenscan.runtime.port import NoPort, Port
from eigenscan.runtime.receive_watchdog import EXIT_DEAF, ReceiveWatchdog
from eigenscan.runtime.session import open_meanwhile
from eigenscan.runtime.settings import ServiceSettings, SettingsError, load
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.runtime.work import Work
from eigenscan.schemas.channels import HEALTH, Channel, ContractError
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK

S = TypeVar("S", bound=ServiceSettings)

HEALTH_PERIOD_S = 1.0
STOP_CORE, CLOSE, STOP_ALL = 0.5, 0.35, 0.95
"""Shares of `stop_s`: what the core gets to end its present message and publish what it holds back; what the
session gets to close, where a neighbour may be slow to take a large answer; when it is ended by force."""
WHOLE_SITE_SLACK = 16
"""A service for a whole site may fall behind so many times farther, while a disk is busy, before it drops."""
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
    prompt: bool = False,
    attend: Callable[[S, zenoh.Session], None] | None = None,
) -> None:
    """Entry point of a service: reads settings, runs until SIGTERM or SIGINT, exits.

    `mode` is that of the Zenoh session where the settings name no configuration file. `whole_site`: also
    receives keys of the site that are not of the contract, to count them, and drops later than others.
    `make_port`: carries those channels of the core that are not of the contract. `prompt`: the core takes
    each message in the thread that brings it; for one that has done with it in well under a millisecond.
    `attend` is given the session once it is open.
    """
    stop = StopEvent()
    with stop.on_signals():
        settings = None
        try:
            settings = load(kind, service)
            port = make_port(settings) if make_port else None
            node = Node(
                service,
                settings,
                lambda: make_core(settings),
                mode,
                stop,
                whole_site=whole_site,
                port=port,
                prompt=prompt,
                attend=(lambda session: attend(settings, session)) if attend else None,
            )
            code = node.run()
        except (SettingsError, ContractError, OSError, ValueError) as error:
            print(f"eigenscan-{service}: {error}", file=sys.stderr)
            code = EXIT_SETTINGS
        except BaseException:
            if settings is None:  # --help, or flags that are none: nothing more to print
                raise
            traceback.print_exc()
            code = EXIT_CORE
    sys.stdout.flush()
    sys.stderr.flush()
    # all is closed; a last thread of Zenoh or of the core would abort the interpreter's own end
    os._exit(code)


class Node:
    """Runs one core on Zenoh."""

    def __init__(
        self,
        service: str,
        settings: ServiceSettings,
        make_core: Callable[[], Core],
        mode: str = "peer",
        stop: StopEvent | None = None,
        *,
        whole_site: bool = False,
        port: Port | None = None,
        prompt: bool = False,
        attend: Callable[[zenoh.Session], None] | None = None,
    ) -> None:
        self._attend = attend
        self.service, self.settings = service, settings
        self._whole_site, self._prompt = whole_site, prompt
        self._make_core, self._mode = make_core, mode
        self._stop = stop or StopEvent()
        self._told = (Health.STATUS_UNSPECIFIED, "")
        self._twins = 0
        self._log = configure(
            settings.log_level, settings.log_format, service=service, instance=settings.instance
        )
        self._counters = Counters(self._log)
        self._monitor = Monitor(
            service, settings.instance, _package_version(service), settings=settings.told()
        )
        self._inbox = Inbox(WHOLE_SITE_SLACK if whole_site else 1, settings.behind_after)
        self._bus: Bus | None = None
        self._keepsake: LatchedCache | None = None
        self._port = port or NoPort()
        self._fault: BaseException | None = None
        self._deaf = False

    def stop(self) -> None:
        """Asks the node to end, from any thread."""
        self._stop.stop()

    def run(self) -> int:
        """Runs until stopped; gives the exit code. Raises what ended the core before that."""
        settings = self.settings
        if settings.metrics_port is not None:
            port = self._monitor.serve(settings.metrics_host, settings.metrics_port)
            self._log.info("metrics", url=f"http://{settings.metrics_host}:{port}/metrics")
        core = threading.Thread(target=self._run_core, name="core", daemon=True)
        core.start()
        self._tend(core)
        faulthandler.dump_traceback_later(STOP_ALL * settings.stop_s, exit=True)
        try:
            self._inbox.close()
            core.join(STOP_CORE * settings.stop_s)
            unfinished = core.is_alive()
            if self._bus:
                closing = threading.Thread(target=self._close, args=(self._bus,), name="close", daemon=True)
                closing.start()
                closing.join(CLOSE * settings.stop_s)
                unfinished = unfinished or closing.is_alive()
            self._monitor.close()
        finally:
            faulthandler.cancel_dump_traceback_later()
        if self._fault:
            raise self._fault
        counts: dict[str, Any] = dict(self._counters.counts)
        self._log.info("stopped", unfinished=unfinished, **counts)
        if self._deaf:
            return EXIT_DEAF
        return EXIT_CORE if self._counters.counts["finish_failed"] else 0

    def _tend(self, core: threading.Thread) -> None:
        """Tells the service's health once a second and at every change, until the end is asked for."""
        looked = time.monotonic()
        while not self._stop.stopping and core.is_alive():
            self._stop.wait(HEALTH_PERIOD_S)
            if self._bus:
                self._tell(self._bus)
                if time.monotonic() - looked >= HEALTH_PERIOD_S:
                    looked = time.monotonic()
                    self._deaf = self._bus.is_deaf
            if self._deaf:
                self._log.error("deaf", hint="nothing of the other services arrives: ending to be restarted")
                return

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
            self._counters.warn("duplicate_instance", hint=TWIN_HINT)

    def _run_core(self) -> None:
        try:
            opening = open_meanwhile(self.settings.zenoh, self._mode)
            core = self._made_core()
            session = opening.result()
            if self._attend:
                self._attend(session)
            bus = self._connect(core, session)
            apart = self._port.channels

            def say(envelope: Envelope) -> None:
                (self._port if envelope.channel in apart else bus).say(envelope)

            work = Work(
                core,
                self._inbox,
                say,
                self._keep,
                self._monitor,
                self._counters,
                self._stop,
                prompt=self._prompt,
            )
            work.begin()
            self._log.info("ready", site=self.settings.site, robot=self.settings.robot)
            work.run()
        except BaseException as error:
            self._fault = error
        self._stop.set()

    def _made_core(self) -> Core:
        """The core. What it imports stays: the garbage collector neither looks at it meanwhile nor later."""
        gc.disable()
        try:
            return self._make_core()
        finally:
            gc.freeze()
            gc.enable()

    def _connect(self, core: Core, session: zenoh.Session) -> Bus:
        settings = self.settings
        address = {"site": settings.site}
        if settings.robot != "*":
            address["robot"] = settings.robot
        bus = self._bus = Bus(session)
        apart = (*self._port.channels, TICK)
        hears = [channel for channel in core.hears if channel not in apart]
        bus.offer([channel for channel in core.says if channel not in apart], address)
        if self._whole_site and settings.robot == "*":
            bus.listen_all(hears, f"{settings.site}/**", self._inbox)
        else:
            bus.listen(hears, address, self._inbox, self._remember(hears))
        bus.announce(settings.site, self.service, settings.instance)
        if settings.deaf_after:
            watchdog = ReceiveWatchdog(round(settings.deaf_after / HEALTH_PERIOD_S))
            bus.watch_others(watchdog, settings.site, self.service, settings.instance)
        self._port.open(self._inbox)
        return bus

    def _remember(self, hears: Sequence[Channel]) -> list[Arrival]:
        """Gives the core the samples that were cached on disk; returns the cache."""
        if self.settings.keep is None:
            return []
        self._keepsake = LatchedCache(self.settings.keep)
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
            self._counters.set_aside("not_kept", sample.key, error)

    def _close(self, bus: Bus) -> None:
        self._port.close()
        bus.close()


def _package_version(service: str) -> str:
    for distribution in (f"eigenscan-{service}", "eigenscan-runtime"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return ""
