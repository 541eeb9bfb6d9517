"""The shell around a core: session, inbox, liveliness, health, metrics, shutdown.

The core has its own thread. The main thread publishes the health and handles signals, so both work while the
core computes.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, Generic, TypeVar

import zenoh
from eigenscan.runtime.bus import Bus
from eigenscan.runtime.certificates import fault_in
from eigenscan.runtime.clock import Clock, Later, later
from eigenscan.runtime.closed_streams import lead_nowhere
from eigenscan.runtime.counters import Counters
from eigenscan.runtime.errors import one_line
from eigenscan.runtime.exchange import Exchange
from eigenscan.runtime.first_start import HINT, compiling, should_start_again, start_again
from eigenscan.runtime.health import DUPLICATE_HINT, Monitor
from eigenscan.runtime.inbox import Arrival, Inbox
from eigenscan.runtime.interruptions import Interruptions
from eigenscan.runtime.latched_cache import ASIDE, FAILED_STARTS, LatchedCache
from eigenscan.runtime.logs import configure, logger
from eigenscan.runtime.memory import StartMemory
from eigenscan.runtime.port import NoPort, Port
from eigenscan.runtime.printable import in_link
from eigenscan.runtime.receive_watchdog import EXIT_DEAF, ReceiveWatchdog
from eigenscan.runtime.session import open_meanwhile
from eigenscan.runtime.settings import ServiceSettings, SettingsError, load
from eigenscan.runtime.stop_event import StopEvent, Stopping
from eigenscan.runtime.work import Work
from eigenscan.schemas.channels import HEALTH, Channel, ContractError
from eigenscan.schemas.envelope import Core, Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.tick import TICK

S = TypeVar("S", bound=ServiceSettings)
T = TypeVar("T")

HEALTH_PERIOD_S = 1.0
STOP_CORE, DRAIN, CLOSE, STOP_ALL = 0.5, 0.25, 0.35, 0.95
"""Shares of the setting `stop_s`: for the core to end its message and publish what it holds back; the part of
that in which a service of a whole site handles waiting messages; for the session to close, which a slow
neighbour may delay; and until the process ends by force."""
WHOLE_SITE_SLACK = 16
"""Factor on the inbox's depth for a service of a whole site, which a busy disk may delay."""
PROVEN_S = 10.0
"""After the last cached sample was handled, until they count as harmless: some crash at the next scan."""
EXIT_SETTINGS = 2
EXIT_CORE = 1


@dataclass(frozen=True)
class Service(Generic[S]):
    """A service as the shell runs it.

    `mode`: of the Zenoh session, if the settings name no configuration file. `whole_site`: also receives keys
    of the site outside the contract, to count them; has a deeper inbox, and empties it before it stops.
    `make_port`: makes the carrier of the core's channels outside the contract. `prompt`: the core handles
    each message in Zenoh's thread; only for a core that needs far less than a millisecond. `attend`: called
    with the open session. `quick`: the core needs milliseconds for a message, so such services share a thread
    if they share a process. `batch_s`: messages wait up to this long and are then handled in a row; for a
    core whose answers nobody waits for. `patience_s`: the same for `patient` inputs alone; any other message
    ends their wait too. `lives_on`: without this input the service is WAITING. `compiles`: numba compiles
    while the core is made, if nothing compiled is kept.
    """

    name: str
    kind: type[S]
    make_core: Callable[[S], Core]
    mode: str = "peer"
    whole_site: bool = False
    make_port: Callable[[S], Port] | None = None
    prompt: bool = False
    attend: Callable[[S, zenoh.Session], None] | None = None
    quick: bool = False
    batch_s: Callable[[S], float] = lambda _: 0.0
    patient: tuple[Channel, ...] = ()
    patience_s: Callable[[S], float] = lambda _: 0.0
    lives_on: Channel | None = None
    compiles: bool = False


def main(service: Service[Any]) -> None:
    """Entry point of a service: reads settings, runs until SIGTERM or SIGINT, exits."""
    exit_with(
        service.name,
        lambda: load(service.kind, service.name),
        lambda settings, stop: Node(service, settings, stop).run(),
    )


def exit_with(name: str, read: Callable[[], T], run: Callable[[T, StopEvent], int]) -> None:
    """Reads settings, runs until SIGTERM or SIGINT, and exits with the code of `run` or of its error."""
    lead_nowhere()
    stop = StopEvent()
    with stop.on_signals():
        settings = None
        try:
            settings = read()
            code = run(settings, stop)
        except (SettingsError, ContractError, OSError, ValueError) as error:
            print(f"eigenscan-{name}: {one_line(error)}", file=sys.stderr)
            code = EXIT_SETTINGS
        except BaseException:
            if settings is None:  # --help: nothing more to print
                raise
            traceback.print_exc()
            code = EXIT_CORE
    sys.stdout.flush()
    sys.stderr.flush()
    # a remaining thread of Zenoh or of the core would abort the interpreter's own end
    os._exit(code)


@dataclass(frozen=True)
class Shared:
    """Parts that the services of one process share, or that a simulation supplies."""

    opening: Future[zenoh.Session]
    exchange: Exchange | None
    ready: threading.Condition
    """Wakes the thread that empties several inboxes."""
    clock: Clock = time
    after: Later = later


class Node:
    """Runs one core on Zenoh."""

    def __init__(
        self,
        service: Service[Any],
        settings: ServiceSettings,
        stop: StopEvent,
        *,
        shared: Shared | None = None,
        ends: Stopping | None = None,
    ) -> None:
        """`stop` wakes the main thread. `ends` ends this service; default: `stop`."""
        self.service, self.settings = service, settings
        self._stop, self._shared = stop, shared
        self._clock = shared.clock if shared else time
        self.ends: Stopping = ends or stop
        self._reported = (Health.STATUS_UNSPECIFIED, "")
        self._duplicates = 0
        self._interruptions = Interruptions()
        self._log = (
            logger().bound(service=service.name, instance=settings.instance)
            if shared
            else configure(
                settings.log_level, settings.log_format, service=service.name, instance=settings.instance
            )
        )
        self._counters = Counters(self._log, self._clock)
        self._monitor = Monitor(
            service.name,
            settings.instance,
            _package_version(service.name),
            settings=settings.answering_json(),
            clock=self._clock,
        )
        slack = WHOLE_SITE_SLACK if service.whole_site else 1
        ready = shared.ready if shared and service.quick else None
        batch_s, patience_s = service.batch_s(settings), service.patience_s(settings)
        self._patient = service.patient if patience_s else ()
        self.inbox = Inbox(
            slack,
            settings.behind_after,
            self._clock.monotonic,
            ready,
            batch_s=batch_s or patience_s,
            wakes=not batch_s,
            time_of_day=self._clock.time_ns,
        )
        self._bus: Bus | None = None
        self._latched_cache: LatchedCache | None = None
        self._on_trial: set[str] | None = None
        """Keys of cached samples that the core has not handled yet; None: none are on trial."""
        self._tried_at = 0.0
        self._port: Port = service.make_port(settings) if service.make_port else NoPort()
        self.fault: BaseException | None = None
        self._core: Core | None = None
        self.starts_again = False
        """Whether numba compiled while the core was made: the process should start without its memory."""
        self.is_deaf = False
        self._looked = self._clock.monotonic()

    def run(self) -> int:
        """Runs until stopped; returns the exit code. Raises the error that ended the core, if any."""
        self.serve_metrics()
        core = threading.Thread(target=self.run_core, name="core", daemon=True)
        core.start()
        memory = StartMemory()
        while not self._stop.stopping and core.is_alive() and not self.is_deaf:
            self._stop.wait(HEALTH_PERIOD_S)
            self.report()
            memory.tend()
        self.ends.stopping = True  # also where it ends because it is deaf
        stop_s = self.settings.stop_s
        faulthandler.dump_traceback_later(STOP_ALL * stop_s, exit=True)
        try:
            self.inbox.close(discard=not self.service.whole_site)
            core.join(STOP_CORE * stop_s)
            closed = self.close(CLOSE * stop_s)
        finally:
            faulthandler.cancel_dump_traceback_later()
        if self.fault:
            raise self.fault
        return self.code(unfinished=core.is_alive() or not closed)

    def serve_metrics(self) -> None:
        """Serves /metrics, if the settings name a port. Raises SettingsError."""
        settings = self.settings
        if settings.metrics_port is not None:
            port = self._monitor.serve(settings.metrics_host, settings.metrics_port)
            self._log.info("metrics", url=f"http://{in_link(settings.metrics_host)}:{port}/metrics")

    def close(self, seconds: float) -> bool:
        """Closes port, bus and metrics; returns whether that took less than `seconds`."""
        if self.fault is None:
            self.end_trial()
        closed = True
        if self._bus:
            closing = threading.Thread(target=self._close, args=(self._bus,), name="close", daemon=True)
            closing.start()
            closing.join(seconds)
            closed = not closing.is_alive()
        self._monitor.close()
        return closed

    def code(self, *, unfinished: bool) -> int:
        """Logs the end and returns the exit code."""
        counts: dict[str, Any] = dict(self._counters.counts)
        self._log.info("stopped", unfinished=unfinished, **counts)
        if self.is_deaf:
            return EXIT_DEAF
        return EXIT_CORE if self._counters.counts["finish_failed"] else 0

    def report(self) -> None:
        """Publishes the service's health. Call it once a second and at every change."""
        if not self._bus:
            return
        if self._on_trial == set() and self._clock.monotonic() - self._tried_at > PROVEN_S:
            self.end_trial()
        since_s = self._clock.monotonic() - self._looked
        if since_s >= HEALTH_PERIOD_S:
            self._looked += since_s
            if self.service.whole_site:
                self._look_for_losses(self._bus, since_s)
        self._report(self._bus)
        if since_s >= HEALTH_PERIOD_S:
            self.is_deaf = self._bus.is_deaf
        if self.is_deaf:
            self._log.error("deaf", hint="no message of the other services arrives: ending, to be restarted")

    def _look_for_losses(self, bus: Bus, since_s: float) -> None:
        """Lets health report where messages of others are missing."""
        seen = self._interruptions
        bus.look_for_links(seen, since_s)
        self._monitor.missing = seen.problem
        if seen.count:
            self._counters.counts["interrupted"] = seen.count
            self._counters.counts["interrupted_s"] = round(seen.seconds)

    def _report(self, bus: Bus) -> None:
        health = self._monitor.message()
        address = {
            "site": self.settings.site,
            "service": self.service.name,
            "instance": self.settings.instance,
        }
        bus.publish(Envelope(HEALTH, address, health))
        if (health.status, health.detail) != self._reported:
            self._reported = (health.status, health.detail)
            self._log.info("status", status=Health.Status.Name(health.status), detail=health.detail)
        if bus.duplicates > self._duplicates:
            self._duplicates = bus.duplicates
            self._monitor.note_duplicate()
            self._counters.warn("duplicate_instance", hint=DUPLICATE_HINT)

    def run_core(self) -> None:
        """Makes the core and runs it to its last message, in this thread."""
        with self.faults():
            self.begin().run()

    @contextmanager
    def faults(self) -> Iterator[None]:
        """Keeps an error of the core as `fault`, and wakes the main thread at the end."""
        try:
            yield
        except BaseException as error:
            self.fault = error
        self._stop.set()

    def begin(self) -> Work:
        """Makes the core, connects it and publishes its first messages."""
        settings, shared = self.settings, self._shared
        opening = shared.opening if shared else open_meanwhile(settings.zenoh, self.service.mode)
        core = self.make_core()
        if self.starts_again and not shared and not self._stop.stopping:
            start_again()
        if not shared and (fault := fault_in(settings.zenoh)):
            self._log.error("certificate_refused", hint=fault)
        session = opening.result()
        if self.service.attend:
            self.service.attend(settings, session)
        bus = self._connect(core, session)
        apart = self._port.channels

        def publish(envelope: Envelope) -> None:
            (self._port if envelope.channel in apart else bus).publish(envelope)

        work = Work(
            core,
            self.inbox,
            publish if apart else bus.publish,
            self._keep,
            self._monitor,
            self._counters,
            self.ends,
            prompt=self.service.prompt,
            drain_s=DRAIN * settings.stop_s if self.service.whole_site else 0.0,
            clock=self._clock,
            lives_on=self.service.lives_on,
        )
        work.begin()
        self._log.info("ready", site=settings.site, robot=settings.robot)
        return work

    def make_core(self) -> Core:
        """Makes the core, once. Its imports stay, so the garbage collector skips them now and later."""
        if self._core is None:
            self._core = self._made_core()
        return self._core

    def _made_core(self) -> Core:
        gc.disable()
        try:
            if not self.service.compiles:
                return self.service.make_core(self.settings)
            with compiling(lambda: self._log.info("compiling", hint=HINT)) as compiled:
                core = self.service.make_core(self.settings)
            self.starts_again = should_start_again(compiled)
            return core
        finally:
            gc.freeze()
            gc.enable()

    def _connect(self, core: Core, session: zenoh.Session) -> Bus:
        settings = self.settings
        address = {"site": settings.site}
        if settings.robot != "*":
            address["robot"] = settings.robot
        shared, inside = self._shared, self.service.prompt
        if shared:
            bus = Bus(session, shared.exchange, shared.after, publishes_inside=inside)
        else:
            bus = Bus(session, publishes_inside=inside)
        self._bus = bus
        apart = (*self._port.channels, TICK)
        inputs = [channel for channel in core.inputs if channel not in apart]
        bus.offer([channel for channel in core.outputs if channel not in apart], address)
        if self.service.whole_site and settings.robot == "*":
            bus.listen_all(inputs, f"{settings.site}/**", self.inbox)
        else:
            bus.listen(inputs, address, self.inbox, self._remember(inputs), self._patient)
        bus.announce(settings.site, self.service.name, settings.instance)
        if settings.deaf_after:
            watchdog = ReceiveWatchdog(round(settings.deaf_after / HEALTH_PERIOD_S))
            bus.watch_others(watchdog, settings.site, self.service.name, settings.instance)
        self._port.open(self.inbox)
        return bus

    def _remember(self, inputs: Sequence[Channel]) -> list[Arrival]:
        """Gives the core the samples that are cached on disk, and returns them."""
        if self.settings.keep is None:
            return []
        self._latched_cache = LatchedCache(self.settings.keep, self.service.name)
        known = list(self._latched_cache.read(self.settings.site, inputs))
        try:
            is_set_aside = bool(known) and self._latched_cache.try_out()
        except OSError as error:
            self._counters.set_aside("not_kept", "", error)
            is_set_aside = False
        if is_set_aside:
            self._monitor.remark = (
                f"cached maps and models were set aside after {FAILED_STARTS} failed starts, "
                f"see {self.settings.keep / ASIDE}"
            )
            self._counters.counts["cache_set_aside"] += 1
            self._log.error("cache_set_aside", hint=self._monitor.remark)
            return []
        if known:
            self._on_trial = {sample.key for sample in known}
        for sample in known:
            self.inbox.put(sample.channel, sample.key, sample.payload, sample.encoding)
        return known

    def end_trial(self) -> None:
        """What is cached does no harm: the service has worked with it, or ends in good order."""
        if self._latched_cache is not None and self._on_trial is not None:
            self._on_trial = None
            with suppress(OSError):  # a start too many is noted
                self._latched_cache.prove()

    def _keep(self, sample: Arrival) -> None:
        if self._latched_cache is None:
            return
        if self._on_trial and sample.key in self._on_trial:
            self._tried_at = self._clock.monotonic()
            self._on_trial.discard(sample.key)
        try:
            self._latched_cache.put(sample)
        except OSError as error:
            self._counters.set_aside("not_kept", sample.key, error)

    def _close(self, bus: Bus) -> None:
        self._port.close()
        bus.close()


@cache
def _package_version(service: str) -> str:
    for distribution in (f"eigenscan-{service}", "eigenscan-runtime"):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return ""
