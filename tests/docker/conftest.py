"""Images of this session: built once, gone at its end."""

import os
import shutil
import subprocess
import time
import uuid
from collections.abc import Callable, Iterator

import pytest

from tests.environment import ROOT

BASE = "python:3.11-slim-bookworm"
MAKE_BASE = ROOT.parent / "shared/tools/make-base-image"
GIVEN = os.environ.get("EIGENSCAN_TEST_IMAGES")
"""Prefix of images that are there already, for who works on these tests."""
PROFILES = ("--profile", "demo", "--profile", "ros2")

MARKS = [
    pytest.mark.docker,
    pytest.mark.timeout(2400),
    pytest.mark.skipif(
        shutil.which("docker") is None
        or subprocess.run(["docker", "info"], check=False, capture_output=True).returncode != 0,
        reason="no Docker here",
    ),
]


def docker(*arguments: object, check: bool = True) -> str:
    """What docker prints. Fails where it does, if `check`."""
    done = subprocess.run(
        ["docker", *map(str, arguments)], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0 or not check, f"{arguments}: {done.stderr}"
    return done.stdout + done.stderr


def until(condition: Callable[[], bool], limit_s: float, what: Callable[[], str]) -> None:
    """Waits for a condition, or fails with what `what` states."""
    end = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end, what()
        time.sleep(0.2)


def compose_command() -> list[str]:
    plugin = subprocess.run(["docker", "compose", "version"], capture_output=True, check=False)
    return ["docker", "compose"] if plugin.returncode == 0 else ["docker-compose"]


def compose(
    *arguments: str, environment: dict[str, str], files: tuple[str, ...] = ("docker-compose.yml",)
) -> str:
    """Output of docker-compose in the repository. Fails where it does."""
    named = [word for file in files for word in ("-f", file)]
    ran = subprocess.run(
        [*compose_command(), *named, *arguments],
        cwd=ROOT, env=os.environ | environment, capture_output=True, text=True, check=False, timeout=1800,
    )  # fmt: skip
    assert ran.returncode == 0, f"{arguments}: {ran.stdout[-3000:]}\n{ran.stderr[-6000:]}"
    return ran.stdout


@pytest.fixture(scope="session")
def base() -> str:
    """The image that all begin with."""
    has_base = subprocess.run(["docker", "image", "inspect", BASE], capture_output=True, check=False)
    if has_base.returncode and subprocess.run(["docker", "pull", "-q", BASE], check=False).returncode:
        subprocess.run([MAKE_BASE], check=True, timeout=900)
    return BASE


@pytest.fixture(scope="session")
def images(request: pytest.FixtureRequest) -> Iterator[str]:
    """Prefix of the images of all services."""
    if GIVEN:
        yield GIVEN
        return
    assert shutil.which("docker")
    request.getfixturevalue("base")
    prefix = f"eigenscan-images-{uuid.uuid4().hex[:8]}"
    try:
        compose(*PROFILES, "build", environment={"EIGENSCAN_IMAGES": prefix})
        yield prefix
    finally:
        listed = subprocess.run(
            ["docker", "images", "-q", f"{prefix}/*"], capture_output=True, text=True, check=False
        )
        subprocess.run(["docker", "rmi", "-f", *listed.stdout.split()], capture_output=True, check=False)
