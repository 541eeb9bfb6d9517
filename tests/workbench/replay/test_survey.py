"""What a recording's health shows of a service."""

from __future__ import annotations

from eigenscan.schemas.health_pb2 import Health
from eigenscan.workbench.replay.survey import Reported


def test_only_counters_that_fall_show_a_restart() -> None:
    """A mapbuilder whose map had got smaller was noted as started again."""
    found = Reported()
    for n, positions in enumerate((900, 800)):
        found.receive(Health(counters={"taken_scan": 10 + n, "positions": positions}))
    assert found.restarts == 0
    assert found.grown["taken_scan"] == 1
    found.receive(Health(counters={"taken_scan": 1, "positions": 800}))
    assert found.restarts == 1
