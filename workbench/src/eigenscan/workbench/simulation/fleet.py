"""Several robots in one building: each seen by the others, all among the same people."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import replace

from eigenscan.geometry.gridmap import GridMap
from eigenscan.workbench.simulation.stage import Scenario, Stage, Timed


class Fleet:
    """`count` robots; where there are several, they are named r1, r2, … after the scenario's robot r.

    They do not give way to each other. Raises MapError where a robot fits nowhere.
    """

    def __init__(self, grid: GridMap, scenario: Scenario, count: int = 1) -> None:
        names = [scenario.robot] if count == 1 else [f"{scenario.robot}{k}" for k in range(1, count + 1)]
        self.stages = [
            Stage(grid, replace(scenario, robot=name, number=number)) for number, name in enumerate(names)
        ]
        for stage in self.stages:
            stage.others = [other for other in self.stages if other is not stage]

    def begin(self, epoch: int) -> None:
        """Sets the stamp of the first message, ns."""
        for stage in self.stages:
            stage.epoch = epoch

    def messages(self) -> Iterator[Timed]:
        """Those of all robots, in order of time."""
        return heapq.merge(*(stage.messages() for stage in self.stages), key=lambda timed: timed.time)
