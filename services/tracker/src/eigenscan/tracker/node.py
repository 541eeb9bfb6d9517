"""The tracker as a process on Zenoh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eigenscan.runtime.node import main as run
from eigenscan.tracker.settings import TrackerSettings

if TYPE_CHECKING:
    from eigenscan.tracker.core import TrackerCore


def main() -> None:
    """Entry point of `eigenscan-tracker`."""
    run("tracker", TrackerSettings, _make_core)


def _make_core(settings: TrackerSettings) -> TrackerCore:
    from eigenscan.tracker.core import TrackerCore  # it takes its time, and neighbours are found meanwhile

    if settings.last_pose is None:
        return TrackerCore(settings)
    from eigenscan.tracker.last_pose import RememberingTracker

    return RememberingTracker(settings, settings.last_pose)
