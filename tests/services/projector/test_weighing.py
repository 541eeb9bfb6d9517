"""What is compiled into one call against its steps, one after another in numpy."""

import numpy as np
import pytest
from eigenscan.geometry.circle import difference
from eigenscan.geometry.pose import compose, inverse
from eigenscan.projector.likelihood import Exactness
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import observe
from eigenscan.projector.publishing import to_base
from eigenscan.projector.refinement import POLISH, fit
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.projector.weighing import weigh
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.services.projector.office import free_poses, scan_at, site
from tests.services.projector.steps import beyond_walls, clearance, support

OFF_THE_MAP = np.array([-40.0, 3.0, 0.0])
UNKNOWN_GROUND = 0.1
"""Written out: support that a pose off the known map loses."""


@pytest.fixture(scope="module")
def office() -> Site:
    model = site(spacing=1.0, components=4)
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    return Site(whole, ProjectorSettings())


@pytest.mark.parametrize("inexactness", [0.0, 0.1])
@pytest.mark.parametrize("field_of_view", [np.pi, 2.0 * np.pi])
def test_weighing_is_fitting_casting_clearing_and_supporting(
    office: Site, field_of_view: float, inexactness: float
) -> None:
    rng, exactness = np.random.default_rng(5), Exactness.of(inexactness)
    for number, truth in enumerate(free_poses(12, 31)):
        seen = observe(scan_at(truth, field_of_view=field_of_view, seed=number))
        slid = truth + rng.uniform(-1.0, 1.0, (5, 3)) * [0.5, 0.5, 0.2]
        slid[4] = OFF_THE_MAP
        reading = office.readings[0]
        bearings, ranges = seen.weighed
        found, supported, explained = weigh(
            reading.walls, reading.caster, office.drawn, slid, seen.points, seen.weighed, exactness
        )

        polished = fit(reading.walls, slid, seen.points, POLISH)
        entered = reading.caster.cast(polished.poses, bearings, ranges)
        clear = clearance(office.drawn, polished.poses, bearings, entered, ranges)
        through = exactness.sure * beyond_walls(clear, exactness.scale)
        mean, share = support(reading.walls, polished.poses, bearings, ranges, through, exactness.scale)
        assert np.allclose(difference(found.poses[:, 2], polished.poses[:, 2]), 0.0, atol=1e-6)
        assert np.allclose(found.poses[:, :2], polished.poses[:, :2], atol=1e-6)
        assert np.allclose(found.cost, polished.cost, atol=1e-6)
        assert np.allclose(found.information, polished.information, rtol=1e-4, atol=1e-2)
        dark = office.caster.in_dark(polished.poses[:, :2])
        assert dark[4]
        counted = 1.0 - exactness.gain * (1.0 - mean)
        assert np.allclose(supported, counted - UNKNOWN_GROUND * dark, atol=1e-5)
        assert np.allclose(explained, share, atol=1.0 / len(ranges))


@pytest.mark.parametrize("seed", range(3))
def test_clearance_is_a_walk_along_each_beam(office: Site, seed: int) -> None:
    field, rng = office.drawn, np.random.default_rng(seed)
    poses = np.vstack([free_poses(6, seed), OFF_THE_MAP])
    bearings = rng.uniform(-np.pi, np.pi, 40)
    entered = rng.uniform(0.0, 6.0, (7, 40)).astype(np.float32)
    entered[rng.random((7, 40)) < 0.2] = np.inf
    seen = rng.uniform(0.0, 12.0, 40).astype(np.float32)
    found = clearance(field, poses, bearings, entered, seen)
    height, width = field.cells.shape
    wanted = np.zeros(entered.shape)
    for i, (x, y, theta) in enumerate(field.cells_of(poses)):
        for j, end in enumerate(seen.astype(float)):
            along, most = float(entered[i, j]), 0.0
            if along >= end:
                continue
            along += 0.5 * field.cell
            while most < 0.5:
                along = min(along, end)
                u = x + np.cos(theta + bearings[j]) * along / field.cell
                v = y + np.sin(theta + bearings[j]) * along / field.cell
                if not (0 <= u < width and 0 <= v < height):
                    most = 0.5
                    break
                distance = (int(field.cells[int(v), int(u)]) & 0xFFF) / 4095.0
                most = max(most, distance)
                if along >= end:
                    break
                along += max(most - distance, 0.5 * field.cell, 0.1)
            wanted[i, j] = most
    assert 0.2 < np.mean(wanted > 0.0) < 0.8
    # a step that falls on a cell's edge may be on its other side
    assert np.mean(np.abs(found - wanted) < 1e-6) > 0.99


POSES = st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0), st.floats(-np.pi, np.pi))


@settings(max_examples=100, deadline=None)
@given(POSES, POSES, st.integers(0, 2**16))
def test_a_base_moves_with_its_sensor(
    sensor: tuple[float, float, float], mount: tuple[float, float, float], seed: int
) -> None:
    pose, lidar = np.array(sensor), np.array(mount)
    root = np.random.default_rng(seed).normal(size=(3, 3))
    C = root @ root.T + np.eye(3)
    (base,), (covariance,) = to_base(pose[None], C[None], lidar)
    wanted = compose(pose, inverse(lidar))
    assert np.allclose(base[:2], wanted[:2], atol=1e-9)
    assert abs(difference(base[2], wanted[2])) < 1e-9
    assert -np.pi <= base[2] < np.pi
    # by differences: how the base moves where the sensor does
    step = 1e-6
    moved = [compose(pose + step * axis, inverse(lidar)) for axis in np.eye(3)]
    J = np.column_stack([np.append(one[:2] - wanted[:2], difference(one[2], wanted[2])) for one in moved])
    J /= step
    assert np.allclose(covariance, J @ C @ J.T, rtol=1e-3, atol=1e-3 * np.abs(covariance).max())
