"""Serves Rerun's web viewer, a static page, on one address only.

The Python call of Rerun listens on every address of the host, its command does not; so it runs as a child.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import rerun_cli  # type: ignore[import-untyped]

PR_SET_PDEATHSIG = 1
STOP_S = 0.3


@contextmanager
def serve_viewer(host: str, port: int, *sources: str) -> Iterator[None]:
    """Serves the page on `host`:`port` for as long as the context lasts.

    With `sources` (addresses of a picture's data, or files) it shows them when opened without any in its URL.
    """
    with TemporaryDirectory(prefix="eigenscan-viewer-") as home:
        # a home of its own: nothing is sent about its use, and a read-only container will do
        environment = os.environ | {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home}
        arguments = ["--serve-web", "--bind", host, "--web-viewer-port", str(port), *sources]
        child = subprocess.Popen(
            [sys.executable, "-m", __name__, *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            yield
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
