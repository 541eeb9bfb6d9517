"""The tracker as a process on Zenoh."""

from __future__ import annotations

import time

from eigenscan.schemas.channels import HEADING, HYPOTHESES, ODOMETRY, SCAN_MOTION
from eigenscan.schemas.envelope import Core
from eigenscan.schemas.extra import needs

with needs("eigenscan-tracker[node]", SystemExit):
    from eigenscan.runtime.clock import Clock
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run
    from eigenscan.tracker.options import TrackerOptions


def make_core(options: TrackerOptions, clock: Clock = time) -> Core:
    """The core; it begins at the last poses where the options name their folder."""
    from eigenscan.tracker.core import TrackerCore  # it takes its time, and neighbours are found meanwhile

    core = TrackerCore(options)
    if options.last_pose is None:
        return core
    from eigenscan.tracker.last_pose import Remembering

    return Remembering(core, options, options.last_pose, clock.time_ns)


def patience_s(options: TrackerOptions) -> float:
    """How long odometry may wait for hypotheses, s: the time between two transforms.

    Not at all where a pose waits for odometry.
    """
    return 1.0 / options.transform_hz if options.at_once else 0.0


SERVICE = Service(
    "tracker",
    TrackerOptions,
    make_core,
    quick=True,
    patient=(ODOMETRY, HEADING, SCAN_MOTION),
    patience_s=patience_s,
    lives_on=HYPOTHESES,
    compiles=True,
)


def main() -> None:
    """Entry point of `eigenscan-tracker`."""
    run(SERVICE)
