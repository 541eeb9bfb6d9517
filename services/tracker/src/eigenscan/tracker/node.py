"""The tracker as a process on Zenoh."""

from __future__ import annotations

from eigenscan.schemas.envelope import Core
from eigenscan.schemas.extra import needs

with needs("eigenscan-tracker[node]", SystemExit):
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run
    from eigenscan.tracker.options import TrackerOptions


def _make_core(options: TrackerOptions) -> Core:
    from eigenscan.tracker.core import TrackerCore  # it takes its time, and neighbours are found meanwhile

    core = TrackerCore(options)
    if options.last_pose is None:
        return core
    from eigenscan.tracker.last_pose import Remembering

    return Remembering(core, options, options.last_pose)


SERVICE = Service("tracker", TrackerOptions, _make_core, quick=True)


def main() -> None:
    """Entry point of `eigenscan-tracker`."""
    run(SERVICE)
