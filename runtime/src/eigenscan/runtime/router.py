"""A Zenoh router with the shell of every other service: health, metrics, liveliness, clean shutdown."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Iterable
from pathlib import Path

import zenoh
from eigenscan.runtime import node
from eigenscan.runtime.certificates import fault_in
from eigenscan.runtime.link_watchdog import await_dead_link, endpoints_in
from eigenscan.runtime.logs import logger
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Condition, Envelope
from eigenscan.schemas.group import EVERY
from eigenscan.schemas.health_pb2 import Health
from pydantic import Field

LOOK_EVERY_S = 1.0
LINK_S = 5.0
"""A router without a link for longer than this is degraded, s: a link takes about one."""
CHECK_EVERY_S = 60.0
"""Certificates end, and are renewed, while the router runs, s."""


class RouterSettings(ServiceSettings):
    """Routes a site's traffic. Without a Zenoh configuration it listens on 127.0.0.1:7448."""

    robot: str = Field(EVERY, description="the robot that it is on; * is the site")
    end_on_change: bool = Field(
        False,
        description="end when the Zenoh configuration changes or the link passes nothing, to be restarted",
    )


class RouterCore:
    """Lets Zenoh's session route, and reports whether the router has the link that it is configured for."""

    inputs: tuple[Channel, ...] = ()
    outputs: tuple[Channel, ...] = ()

    def __init__(self, settings: RouterSettings) -> None:
        self._path = settings.zenoh
        self._session: zenoh.Session | None = None
        self._endpoints = endpoints_in(settings.zenoh)
        self._unlinked_since: float | None = None
        self._fault, self._checked = "", -math.inf

    def attend(self, session: zenoh.Session) -> None:
        """Takes the open session."""
        self._session = session

    def start(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def handle(self, _received: Envelope) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def finish(self) -> Iterable[Envelope]:
        """Nothing."""
        return ()

    def condition(self) -> Condition:
        """Degraded if a certificate is refused, or without a link for longer than LINK_S."""
        now = time.monotonic()
        if now - self._checked > CHECK_EVERY_S:
            self._fault, self._checked = fault_in(self._path), now
        if self._fault:
            return Condition(Health.STATUS_DEGRADED, self._fault)
        if not self._endpoints or self._session is None or self._session.info.routers_zid():
            self._unlinked_since = None
            return Condition(detail="routing")
        self._unlinked_since = now if self._unlinked_since is None else self._unlinked_since
        if now - self._unlinked_since < LINK_S:
            return Condition(detail="routing")
        to = " or ".join(self._endpoints)
        return Condition(
            Health.STATUS_DEGRADED,
            f"no link to {to}: it is out of reach, or refuses this machine's certificate",
        )


def _end_on_change(path: Path) -> None:
    """Ends this process cleanly when `path` holds another configuration that Zenoh can read."""
    log = logger()
    try:
        seen = path.read_bytes()
    except OSError:  # whoever opens the session names it
        return
    while True:
        time.sleep(LOOK_EVERY_S)
        with contextlib.suppress(OSError):  # the file is being replaced
            now = path.read_bytes()
            if now == seen:
                continue
            seen = now
            try:
                zenoh.Config.from_file(str(path))
            except zenoh.ZError as error:
                log.error("configuration_refused", path=str(path), error=str(error))
            else:
                log.info("configuration_changed", path=str(path))
                os.kill(os.getpid(), signal.SIGTERM)
                return


def _end_when_dead(path: Path, session: zenoh.Session) -> None:
    """Ends this process cleanly when its link to another router is up but passes nothing."""
    if await_dead_link(path, session):
        logger().error("link_mute", path=str(path))
        os.kill(os.getpid(), signal.SIGTERM)


class _Router:
    """Makes the core, and gives it the session once that is open."""

    def __init__(self) -> None:
        self._core: RouterCore | None = None

    def make_core(self, settings: RouterSettings) -> RouterCore:
        if settings.end_on_change and settings.zenoh:
            watch = threading.Thread(target=_end_on_change, args=(settings.zenoh,), name="watch", daemon=True)
            watch.start()
        self._core = RouterCore(settings)
        return self._core

    def attend(self, settings: RouterSettings, session: zenoh.Session) -> None:
        if self._core is not None:
            self._core.attend(session)
        if settings.end_on_change and settings.zenoh:
            watch = (settings.zenoh, session)
            threading.Thread(target=_end_when_dead, args=watch, name="link watchdog", daemon=True).start()


_ROUTER = _Router()
SERVICE = node.Service("router", RouterSettings, _ROUTER.make_core, mode="router", attend=_ROUTER.attend)


def main() -> None:
    """Entry point of `eigenscan-router`."""
    node.main(SERVICE)
