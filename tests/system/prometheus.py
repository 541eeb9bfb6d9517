"""Debian's own Prometheus, unpacked rather than installed: nothing of it stays on the machine."""

import json
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.parse import urlencode
from urllib.request import urlopen

PATIENCE_S = 240.0


def find_programs(folder: Path) -> Path:
    """Folder with `prometheus` and `promtool`; fetched by apt-get where they are not installed."""
    installed = shutil.which("promtool")
    if installed:
        return Path(installed).parent
    apt_get = ["apt-get", "-o", "Acquire::Retries=5", "-qq"]
    for command in ([*apt_get, "download", "prometheus"], [*apt_get, "update"]):
        if subprocess.run(command, cwd=folder, check=False, capture_output=True).returncode == 0:
            break
    if not list(folder.glob("*.deb")):
        subprocess.run([*apt_get, "download", "prometheus"], cwd=folder, check=True)
    (package,) = folder.glob("*.deb")
    subprocess.run(["dpkg-deb", "-x", package, folder], check=True)
    return folder / "usr/bin"


@contextmanager
def serving(programs: Path, config: Path, port: int) -> Iterator[str]:
    """A server on `config`, and its address."""
    command = [
        str(programs / "prometheus"),
        f"--config.file={config}",
        f"--storage.tsdb.path={config.parent / 'series'}",
        f"--web.listen-address=127.0.0.1:{port}",
    ]
    with (config.parent / "prometheus.log").open("wb") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log)
    try:
        yield f"http://127.0.0.1:{port}"
    finally:
        process.kill()
        process.wait(PATIENCE_S)


def until_it_has(address: str, expression: str) -> list[Any]:
    """What an expression gives, as soon as that is something."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        try:
            with urlopen(
                f"{address}/api/v1/query?{urlencode({'query': expression})}", timeout=PATIENCE_S
            ) as reply:
                found: list[Any] = json.load(reply)["data"]["result"]
            if found:
                return found
        except URLError:  # it starts
            pass
        time.sleep(0.2)
    raise AssertionError(f"nothing in {PATIENCE_S:.0f} s: {expression}")
