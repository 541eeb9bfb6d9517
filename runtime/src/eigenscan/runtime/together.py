"""Runs several services in one process: same cores, same keys, one session, and messages passed directly.

Quick cores share a thread, so none waits for a thread switch; the one nearest to the pose comes first, also
between two answers of another one. Every other core has its own thread. A service that fails ends the
process, so that all are restarted together.
"""

from __future__ import annotations

import contextlib
import faulthandler
import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import zenoh
from eigenscan.runtime.exchange import Exchange
from eigenscan.runtime.first_start import start_again
from eigenscan.runtime.logs import configure
from eigenscan.runtime.memory import StartMemory
from eigenscan.runtime.node import (
    CLOSE,
    HEALTH_PERIOD_S,
    STOP_ALL,
    STOP_CORE,
    Node,
    Service,
    Shared,
    exit_with,
)
from eigenscan.runtime.session import open_meanwhile
from eigenscan.runtime.settings import LAST_PORT, ServiceSettings, SettingsError, load
from eigenscan.runtime.stop_event import StopEvent
from eigenscan.runtime.work import CONDITION_PERIOD_S, Work

Chosen = list[tuple[Service[Any], ServiceSettings]]

SWITCH_S = 0.0005
"""Longest time that a thread holds the interpreter while another waits, s. With Python's default, 5 ms, a
pose would wait for the recorder."""


class Later:
    """Ends the services that receive the others' last messages."""

    def __init__(self, first: StopEvent) -> None:
        self.stopping = False
        self._first = first

    def set(self) -> None:
        """Wakes the main thread."""
        self._first.set()


Groups = Sequence[tuple[Sequence[str], Sequence[str]]]
"""Names of services, and their flags."""


def main(groups: Callable[[], Groups], find: Callable[[str], Service[Any]]) -> None:
    """Runs services, nearest to the sensor first, until SIGTERM or SIGINT; then exits."""
    exit_with("together", lambda: read(groups(), find), lambda chosen, stop: Together(chosen, stop).run())


def read(groups: Groups, find: Callable[[str], Service[Any]]) -> Chosen:
    """Settings of each service. Raises SettingsError if one process cannot have them."""
    chosen: Chosen = []
    for names, flags in groups:
        for name in names:
            service = find(name)
            chosen.append((service, load(service.kind, name, list(flags))))
    if len({service.name for service, _ in chosen}) < len(chosen):
        raise SettingsError("a service is named twice: name each once")
    if len({(settings.zenoh, service.mode) for service, settings in chosen}) > 1:
        raise SettingsError("zenoh: must be the same for all services of a process")
    return _own_ports(chosen)


def _own_ports(chosen: Chosen) -> Chosen:
    """If several have the same metrics port, gives them that one and the following ones, in order."""
    taken: set[int] = set()
    result: Chosen = []
    for service, settings in chosen:
        port = settings.metrics_port
        while port and port in taken:
            port += 1
        if port and port > LAST_PORT:
            raise SettingsError(
                f"metrics_port = {settings.metrics_port}: each service of a process takes one more, and "
                f"there is none above {LAST_PORT}: choose a lower one"
            )
        if port:
            taken.add(port)
        result.append((service, settings.model_copy(update={"metrics_port": port})))
    return result


class Together:
    """The services of one process."""

    def __init__(self, chosen: Chosen, stop: StopEvent) -> None:
        first = chosen[0][1]
        configure(first.log_level, first.log_format)
        self._stop, self._later = stop, Later(stop)
        self._ready = threading.Condition()
        opening = open_meanwhile(first.zenoh, chosen[0][0].mode)
        self._shared = Shared(opening, Exchange(), self._ready)
        self._starts_again = False
        self._stop_s = max(settings.stop_s for _, settings in chosen)
        self.nodes = [
            Node(
                service,
                settings,
                stop,
                shared=self._shared,
                ends=self._later if service.whole_site else None,
            )
            for service, settings in chosen
        ]

    def run(self) -> int:
        """Runs until stopped; returns the exit code. Raises the error that ended a core, if any."""
        sys.setswitchinterval(SWITCH_S)
        for node in self.nodes:
            node.serve_metrics()
        quick = [node for node in self.nodes if node.service.quick]
        last = [node for node in self.nodes if node.service.whole_site]
        # receivers of the others' first messages start before them
        threads = {node.service.name: self._thread(node.run_core, node.service.name) for node in last}
        if quick:
            threads["quick"] = self._thread(lambda: self._run_quick(quick), "core")
        for node in self.nodes:
            if node not in (*quick, *last):
                threads[node.service.name] = self._thread(node.run_core, node.service.name)
        self._tend(threads)
        starts_again = self._starts_again and not self._stop.stopping
        faulthandler.dump_traceback_later(STOP_ALL * self._stop_s, exit=True)
        try:
            unfinished = not self._end(threads, last)
        finally:
            faulthandler.cancel_dump_traceback_later()
        for node in self.nodes:
            if node.fault:
                raise node.fault
        code = max([node.code(unfinished=unfinished) for node in self.nodes])
        if starts_again:
            start_again()
        return code

    def _thread(self, run: Callable[[], None], name: str) -> threading.Thread:
        thread = threading.Thread(target=run, name=name, daemon=True)
        thread.start()
        return thread

    def _tend(self, threads: dict[str, threading.Thread]) -> None:
        """Publishes each service's health until the end is requested or one of them ends."""
        memory = StartMemory()
        while not self._stop.stopping and all(thread.is_alive() for thread in threads.values()):
            self._stop.wait(HEALTH_PERIOD_S)
            for node in self.nodes:
                node.report()
            memory.tend()
            if any(node.is_deaf for node in self.nodes):
                return

    def _run_quick(self, nodes: Sequence[Node]) -> None:
        """Runs all quick cores in this thread."""
        works: list[tuple[Node, Work]] = []
        for node in nodes:  # all before the first is seen, for the process may start again
            with node.faults():
                node.make_core()
            if node.fault:
                return
        self._starts_again = any(node.starts_again for node in nodes)
        if self._starts_again:
            return
        for node in nodes:
            with node.faults():
                works.insert(0, (node, node.begin()))
            if node.fault:
                return
        for number, (_, work) in enumerate(works[1:], start=1):
            work.let_go_first = partial(self._work_off, works[:number])
        longest_s = min([CONDITION_PERIOD_S, *(node.inbox.batch_s for node in nodes if node.inbox.batch_s)])
        while not self._stop.stopping:
            if not self._work(works, keep_time=True):
                for node in nodes:
                    node.inbox.sort()
                with self._ready:
                    self._ready.wait_for(
                        lambda: self._stop.stopping or any(len(node.inbox) for node in nodes), longest_s
                    )
            if any(node.fault for node in nodes):
                return
        for _, work in reversed(works):
            work.finish()

    def _work_off(self, works: list[tuple[Node, Work]]) -> None:
        while self._work(works):
            pass

    def _work(self, works: list[tuple[Node, Work]], *, keep_time: bool = False) -> bool:
        """Handles one message, of the service nearest to the pose that has one; False if none waits."""
        for node, work in works:
            try:
                if keep_time:
                    work.keep_time()
                # what came without waking this thread is looked for when nothing else is left
                if node.inbox.is_waiting and work.step():
                    return True
            except BaseException as error:
                node.fault = error
                self._stop.set()
                return False
        return False

    def _end(self, threads: dict[str, threading.Thread], last: Sequence[Node]) -> bool:
        """Ends all services, receivers of the others' messages last; returns whether that was in time."""
        self._stop.stopping = True
        end = time.monotonic() + STOP_CORE * self._stop_s
        for node in self.nodes:
            if node not in last:
                node.inbox.close()
        late = {node.service.name for node in last}
        for name, thread in threads.items():
            if name not in late:
                thread.join(max(0.0, end - time.monotonic()))
        while any(len(node.inbox) for node in last) and time.monotonic() < end:
            time.sleep(0.005)
        self._later.stopping = True
        for node in last:
            node.inbox.close()
            threads[node.service.name].join(max(0.0, end - time.monotonic()))
        finished = not any(thread.is_alive() for thread in threads.values())
        closing = time.monotonic() + CLOSE * self._stop_s
        for node in self.nodes:
            finished &= node.close(max(0.0, closing - time.monotonic()))
        # a session may close slowly, or never have opened
        session = self._thread(self._close_session, "close")
        session.join(max(0.0, closing - time.monotonic()))
        return finished and not session.is_alive()

    def _close_session(self) -> None:
        if self._shared.opening.exception() is None:
            with contextlib.suppress(zenoh.ZError):
                self._shared.opening.result().close()
