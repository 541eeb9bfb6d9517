"""Rides in a lift between the floors of one site: right about the floor, or ambiguous, never wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.geometry.pose import compose
from eigenscan.geometry.raycast import RayCaster
from eigenscan.localize import Estimate, Localizer, Scan
from numpy.typing import NDArray

from tests.library.test_floors import BEAMS, FLOORS, STEP, build
from tests.services.projector.office import free_poses, office

pytestmark = pytest.mark.slow

RIDES, RATE_S, NOISE_M = 6, 0.1, 0.01
DRIVE_SCANS, CABIN_SCANS, STEP_M = 20, 30, 0.1
CABIN_M = 0.8
"""Half a cabin's width."""
CLEAR_M = 2.5
"""Ahead of where a drive begins."""
BEARINGS = (np.arange(BEAMS) - 0.5 * (BEAMS - 1)) * STEP
RIGHT_M = 0.5


@dataclass(frozen=True)
class Moment:
    """What was claimed after one scan; `right`: the floor, and within RIGHT_M there."""

    claimed: bool
    floor: str
    right: bool


@dataclass
class Lift:
    """A robot that drives on one floor, stands in the cabin, and drives on another floor."""

    floors: dict[str, GridMap]
    localizer: Localizer
    random: np.random.Generator
    time: float = 0.0

    def ride(self, number: int) -> tuple[list[Moment], list[Moment]]:
        """Before the cabin and after it."""
        begin, end = list(self.floors)[:: 1 if number % 2 else -1]
        self.localizer.forget()
        odometry = np.zeros(3)
        before, odometry = self._drive(begin, number, odometry)
        cabin = CABIN_M / np.maximum(np.abs(np.cos(BEARINGS)), np.abs(np.sin(BEARINGS)))
        for _ in range(CABIN_SCANS):
            self._see(cabin, odometry)
        after, _ = self._drive(end, number, odometry)
        return before, after

    def _drive(
        self, floor: str, number: int, odometry: NDArray[np.float64]
    ) -> tuple[list[Moment], NDArray[np.float64]]:
        caster, moments = RayCaster.of(self.floors[floor]), list[Moment]()
        start = next(
            pose
            for pose in free_poses(200, number, self.floors[floor])
            if caster.cast(pose, np.zeros(1), 30.0)[0][0] > CLEAR_M
        )
        for step in range(DRIVE_SCANS):
            truth = compose(start, [STEP_M * step, 0.0, 0.0])
            estimate = self._see(caster.cast(truth, BEARINGS, 30.0)[0], odometry)
            on = self.localizer.floor(estimate.pose) if estimate.state != "lost" else None
            near = on is not None and bool(np.hypot(*(on[1] - truth)[:2]) < RIGHT_M)
            name = on[0] if on is not None else ""
            moments.append(Moment(estimate.state == "localized", name, name == floor and near))
            odometry = compose(odometry, [STEP_M, 0.0, 0.0])
        return moments, odometry

    def _see(self, ranges: NDArray[np.float64], odometry: NDArray[np.float64]) -> Estimate:
        self.time += RATE_S
        noisy = ranges + self.random.normal(0.0, NOISE_M, len(ranges))
        return self.localizer.track(Scan(noisy, BEARINGS[0], STEP, 30.0, time=self.time), odometry)


def lift(folder: Path, floors: dict[str, GridMap]) -> Lift:
    for name, grid in floors.items():
        write_map(grid, folder / f"{name}.yaml")
    done = build(folder, *(f"{name}.yaml" for name in floors))
    assert done.returncode == 0, done.stderr
    return Lift(floors, Localizer.from_map(folder / "model"), np.random.default_rng(1))


@pytest.fixture(scope="module")
def unlike(tmp_path_factory: pytest.TempPathFactory) -> Lift:
    return lift(tmp_path_factory.mktemp("unlike"), FLOORS)


@pytest.fixture(scope="module")
def alike(tmp_path_factory: pytest.TempPathFactory) -> Lift:
    """Two floors that are one and the same but for where their maps lie."""
    upper = replace(office(), origin=np.array([3.0, -8.0, 0.2]))
    return lift(tmp_path_factory.mktemp("alike"), {"ground": office(), "first": upper})


@pytest.mark.parametrize("number", range(RIDES))
def test_where_floors_differ_the_floor_is_right_within_a_second(unlike: Lift, number: int) -> None:
    _, after = unlike.ride(number)
    assert not [one for one in after if one.claimed and not one.right]
    assert next(scan for scan, one in enumerate(after) if one.claimed) * RATE_S <= 1.0
    assert after[-1].claimed


@pytest.mark.parametrize("number", range(RIDES))
def test_where_floors_look_the_same_none_is_claimed(alike: Lift, number: int) -> None:
    before, after = alike.ride(number)
    assert not [one for one in (*before, *after) if one.claimed]
    assert all(one.floor for one in after)  # it is on one of them: ambiguous, not lost
