"""A service's process: the real shell around the real core, with turns by the agenda; it ends and starts."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from eigenscan.runtime.node import HEALTH_PERIOD_S, Node, Service, Shared
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.runtime.work import CONDITION_PERIOD_S, Work
from eigenscan.workbench.simtest.agenda import Agenda, MachineClock
from eigenscan.workbench.simtest.disk import Disk, KilledError
from eigenscan.workbench.simtest.first_release import FirstRelease
from eigenscan.workbench.simtest.network import Network
from eigenscan.workbench.simtest.session import Session

RESTART_S = 1.0
"""As deploy/systemd has it: RestartSec."""
HANDLING_S = 0.002
"""That a message takes."""


class _Stop:
    """What ends a service, and wakes its main thread."""

    def __init__(self) -> None:
        self.stopping = False
        self.is_woken = False

    def set(self) -> None:
        self.is_woken = True


class Process:
    """One service on one machine, and who starts it again."""

    def __init__(
        self,
        agenda: Agenda,
        network: Network,
        machine: str,
        clock: MachineClock,
        service: Callable[[Disk], Service[Any]],
        settings: Callable[[Disk], ServiceSettings],
    ) -> None:
        self._agenda, self._network, self._clock = agenda, network, clock
        self.machine = machine
        self._make_service, self._make_settings = service, settings
        self.disk = Disk(clock)
        self.name = f"{service(self.disk).name} of {machine}"
        self.handling_s = HANDLING_S
        self.is_wanted = False
        self.is_of_first_release = False
        """Whether it speaks as the first release did, from its next start on."""
        self.node: Node | None = None
        self.session: Session | None = None
        self.starts = 0
        self.on_end: Callable[[Process, str], None] = lambda _process, _how: None
        """Reported before each end, how: killed, stopped, failed, or with which exit code."""
        self._life = 0
        self._turn_at = self._turn_number = self._busy_until = 0
        self._work: Work | None = None

    @property
    def is_up(self) -> bool:
        """Whether it runs."""
        return self._work is not None

    def start(self) -> None:
        """Begins a life, unless it has one or nobody wants it."""
        if self.is_up or not self.is_wanted:
            return
        self._life += 1
        self.starts += 1
        life = self._life
        self._stop = _Stop()
        self.session = self._network.open(self.machine, self._clock)
        self.session.owner = self
        if self.is_of_first_release:
            self.session.translate = FirstRelease().payload
        opening: Future[Any] = Future()
        opening.set_result(self.session)
        shared = Shared(opening, None, threading.Condition(), self._clock, self._after(life))
        service, settings = self._make_service(self.disk), self._make_settings(self.disk)
        self.node = Node(service, settings, self._stop, shared=shared)  # type: ignore[arg-type]
        try:
            self._work = self.node.begin()
        except KilledError:
            self.end("killed")
            return
        except (OSError, ValueError) as error:
            self.end(f"failed to start: {error}")
            return
        self._schedule(0.0)
        self._report_later(life)

    def _after(self, life: int) -> Callable[[float, Callable[[], None]], None]:
        """What ends with the process."""

        def later(seconds: float, action: Callable[[], None]) -> None:
            self._agenda.after(seconds, lambda: action() if self._life == life and self.is_up else None)

        return later

    def end(self, how: str) -> None:
        """Without a word, as by kill -9; it is started again where it is wanted."""
        self.on_end(self, how)
        self._work = None
        if self.session is not None:
            self._network.close(self.session)
        self.disk.end_process()
        self.node = None
        self._agenda.after(RESTART_S, self.start)

    def stop(self, how: str = "stopped") -> None:
        """In good order, as by SIGTERM."""
        if self._work is None or self.node is None:
            return
        self._stop.stopping = True
        self.node.inbox.close(discard=not self.node.service.whole_site)
        try:
            self._work.finish()
            self.node.end_trial()
        except KilledError:
            self.end("killed")
            return
        self.end(how)

    def wake(self, is_patient: bool) -> None:
        """Something has come; the node looks for what is patient only now and then."""
        if self.is_up and self.node is not None:
            inbox = self.node.inbox
            self._schedule(inbox.batch_s if is_patient or not inbox.wakes else 0.0)

    def _schedule(self, seconds: float) -> None:
        """The next turn, that much after now, but not before the last message is done with."""
        now = self._agenda.now_ns
        due = max(now + round(seconds * 1e9), self._busy_until)
        if self._turn_at and now <= self._turn_at <= due:
            return
        self._turn_at = due
        self._turn_number += 1
        number, life = self._turn_number, self._life

        def turn() -> None:
            if self._life == life and self._turn_number == number and self.is_up:
                self._turn()

        self._agenda.at(due, turn)

    def _turn(self) -> None:
        assert self._work is not None
        assert self.node is not None
        self._turn_at = 0
        try:
            self._work.keep_time()
            if self._work.step():
                self._busy_until = self._agenda.now_ns + round(self.handling_s * 1e9)
            if self._stop.is_woken:
                self._stop.is_woken = False
                self.node.report()
        except KilledError:
            self.end("killed")
            return
        self._schedule(0.0 if len(self.node.inbox) else CONDITION_PERIOD_S)

    def _report_later(self, life: int) -> None:
        def publish() -> None:
            if self._life != life or not self.is_up or self.node is None:
                return
            try:
                self.node.report()
            except KilledError:
                self.end("killed")
                return
            if self.node.is_deaf:
                self.stop("deaf")
                return
            self._report_later(life)

        self._agenda.after(HEALTH_PERIOD_S, publish)
