"""The tracker as a process on Zenoh."""

from __future__ import annotations

from eigenscan.runtime.node import main as run
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.settings import TrackerSettings


def main() -> None:
    """Entry point of `eigenscan-tracker`."""
    run("tracker", TrackerSettings, TrackerCore)
