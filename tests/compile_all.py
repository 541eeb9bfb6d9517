"""Compiles what tests use, once, before several processes each do it: `python -m tests.compile_all`."""

from typing import get_args

import eigenscan.ingest.core
import eigenscan.tracker.core  # noqa: F401 - the same
from eigenscan.projector.association.kinds import Kind
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up

if __name__ == "__main__":
    for kind in get_args(Kind):
        warm_up(ProjectorSettings(association=kind))
