"""What holds for all tests: what is slow, what is skipped, and what runs beside what."""

import os
import signal

import pytest
from hypothesis import HealthCheck, settings
from xdist.scheduler import LoadScopeScheduling

from tests.environment import DATASETS, PATIENT

# the same examples in each run, however slow the machine: what fails here fails everywhere
settings.register_profile(
    "suite", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("suite")

TOGETHER = ("tests/docker/",)
"""Folders whose files share what is made once, so that one process has them all."""
FIRST = ("tests/docker/", "tests/system/test_hour.py")
"""Those that take minutes begin at once, so that nobody waits for them alone."""


class ByFile(LoadScopeScheduling):
    """Each file's tests run in one process, in order; so do those of a folder that shares something."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return next((folder for folder in TOGETHER if file.startswith(folder)), file)


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)


def pytest_configure(config: pytest.Config) -> None:
    """Services take their time; and Ctrl-C works, also where the tests run in a shell's background.

    Such a shell has it ignored, and children inherit that.
    """
    os.environ.update(PATIENT)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False  # pytest_collection_modifyitems has ordered them


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    without_data = pytest.mark.skip(reason="the datasets are not beside the project")
    for item in items:
        if any(map(item.get_closest_marker, ("docker", "browser", "cargo"))):
            item.add_marker(pytest.mark.slow)
        if item.get_closest_marker("dataset") and not DATASETS.is_dir():
            item.add_marker(without_data)
    items.sort(key=_turn)


def _turn(item: pytest.Item) -> int:
    """When a test begins; the last ones wait for a build that goes on beside the others."""
    if item.nodeid.startswith(FIRST):
        return 0
    return 2 if item.get_closest_marker("cargo") else 1
