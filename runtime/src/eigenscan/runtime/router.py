"""A Zenoh router with the shell of every other service: health, metrics, liveliness, clean shutdown."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Iterable
from pathlib import Path

import zenoh
from eigenscan.runtime import node
from eigenscan.runtime.link_watchdog import await_dead_link
from eigenscan.runtime.logs import logger
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Condition, Envelope
from pydantic import Field

LOOK_EVERY_S = 1.0


class RouterSettings(ServiceSettings):
    """Routes a site's traffic. Without a Zenoh configuration it listens on 127.0.0.1:7448."""

    end_on_change: bool = Field(
        False,
        description="end when the Zenoh configuration changes or the link passes nothing, to be restarted",
    )


class RouterCore:
    """Does nothing: Zenoh's session itself routes."""

    inputs: tuple[Channel, ...] = ()
    outputs: tuple[Channel, ...] = ()

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
        """Always well."""
        return Condition(detail="routing")


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


def _attend(settings: RouterSettings, session: zenoh.Session) -> None:
    if settings.end_on_change and settings.zenoh:
        watch = (settings.zenoh, session)
        threading.Thread(target=_end_when_dead, args=watch, name="link watchdog", daemon=True).start()


def _core(settings: RouterSettings) -> RouterCore:
    if settings.end_on_change and settings.zenoh:
        watch = threading.Thread(target=_end_on_change, args=(settings.zenoh,), name="watch", daemon=True)
        watch.start()
    return RouterCore()


SERVICE = node.Service("router", RouterSettings, _core, mode="router", attend=_attend)


def main() -> None:
    """Entry point of `eigenscan-router`."""
    node.main(SERVICE)
