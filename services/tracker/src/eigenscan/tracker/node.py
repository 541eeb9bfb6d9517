"""The tracker as a process on Zenoh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eigenscan.runtime.node import main as run
from eigenscan.tracker.options import TrackerOptions

if TYPE_CHECKING:
    from eigenscan.tracker.core import TrackerCore


def main() -> None:
    """Entry point of `eigenscan-tracker`."""
    run("tracker", TrackerOptions, _make_core)


def _make_core(options: TrackerOptions) -> TrackerCore:
    from eigenscan.tracker.core import TrackerCore  # it takes its time, and neighbours are found meanwhile

    if options.last_pose is None:
        return TrackerCore(options)
    from eigenscan.tracker.last_pose import RememberingTracker

    return RememberingTracker(options, options.last_pose)
