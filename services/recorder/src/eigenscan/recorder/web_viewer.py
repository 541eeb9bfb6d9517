"""Serves Rerun's web viewer, a static page, on one address only.

The Python call of Rerun listens on every address of the host, its command does not; so it runs as a child.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

import rerun_cli  # type: ignore[import-untyped]
from eigenscan.runtime.printable import in_link
from eigenscan.runtime.settings import SettingsError

PR_SET_PDEATHSIG = 1
STOP_S = 0.3


def free_port(field: str, host: str, port: int) -> int:
    """`port`, or a free one if it is 0. Raises SettingsError if it is in use."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise SettingsError(
                f"{field} = {port}: cannot serve on {host} ({error.strerror}): "
                "choose another, or 0 for a free one, or another viewer_host"
            ) from error
        return int(probe.getsockname()[1])


def seen_at(host: str) -> str:
    """The address at which this machine's browser finds what is served on `host`."""
    return in_link({"0.0.0.0": "127.0.0.1", "::": "::1"}.get(host, host))


@dataclass(frozen=True)
class Viewer:
    """A viewer's server. `link`: to the picture."""

    link: str
    server: subprocess.Popen[bytes]

    @property
    def problem(self) -> str:
        """Why the link is dead; empty while it is served."""
        code = self.server.poll()
        return "" if code is None else f"viewer: its server ended with code {code}: start it again"


@contextmanager
def serve_viewer(host: str, page_port: int, data_port: int, picture: Path | None = None) -> Iterator[Viewer]:
    """Serves the viewer's page while the context lasts.

    The page takes its data from `data_port` of the same host: from another server there, or from `picture`, a
    .rrd file, which is then served there.
    """
    source = f"rerun+http://{seen_at(host)}:{data_port}/proxy"
    served = ["--port", str(data_port), str(picture.resolve())] if picture else [source]
    with TemporaryDirectory(prefix="eigenscan-viewer-") as home:
        # an own home folder: no usage data is sent, and a read-only container works
        environment = os.environ | {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home}
        arguments = ["--serve-web", "--bind", host, "--web-viewer-port", str(page_port), *served]
        child = subprocess.Popen(
            [sys.executable, "-m", __name__, *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield Viewer(f"http://{seen_at(host)}:{page_port}/?url={quote(source, safe='')}", child)
        finally:
            child.terminate()
            try:
                child.wait(STOP_S)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _become_viewer(arguments: list[str]) -> None:
    """Replaces this process by the viewer's server, which ends when its parent does, however that ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    command = str(Path(rerun_cli.__file__).with_name("rerun"))
    os.execv(command, [command, *arguments])


if __name__ == "__main__":
    _become_viewer(sys.argv[1:])
