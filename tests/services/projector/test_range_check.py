"""Ranges of a wrong scale or with an offset show on the map."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.range_check import check, set_right
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import RangeCheck
from eigenscan.schemas.scan_pb2 import Scan

from tests.services.projector.office import Array, free_poses, ready, receive, scan_at

POSES = free_poses(12, 3, clearance=0.8)
POSE = POSES[0]


def checked(
    pose: Array, factor: float = 1.0, offset: float = 0.0, seed: int = 0, listed: Array | None = None
) -> RangeCheck:
    seen = observe(measured(scan_at(pose, field_of_view=2 * np.pi, seed=seed), factor, offset))
    found = find_candidates(built(), built().view(seen.sensor), seen, ProjectorSettings())
    if listed is not None:
        found = replace(found, poses=listed[None], explained=np.zeros(1))
    return check(built(), seen, found)


@cache
def built() -> Site:
    at = ready()._site
    assert at is not None
    return at


def measured(scan: Scan, factor: float, offset: float) -> Scan:
    ranges = factor * np.asarray(scan.ranges) + offset
    scan.ranges[:] = np.maximum(ranges, 0.05).tolist()
    return scan


@pytest.mark.parametrize("pose", POSES[:4])
def test_a_scan_that_fits_is_not_tried_otherwise(pose: Array) -> None:
    assert not checked(pose).errors


@pytest.mark.parametrize(("factor", "offset"), [(0.9, 0.0), (1.1, 0.0), (1.25, 0.0), (1.0, 0.3), (1.0, -0.3)])
def test_where_the_pose_is_listed_the_error_is_found(factor: float, offset: float) -> None:
    found = list[tuple[float, float]]()
    for number, pose in enumerate(POSES):
        (stated,) = checked(pose, factor, offset, seed=number, listed=pose).errors
        found.append((stated.factor, stated.offset))
        assert stated.gain > 0.0
        # a tenth of a small room is much like an offset
        assert np.sign(stated.factor - 1.0 + stated.offset) == np.sign(factor - 1.0 + offset)
    assert found.count((factor, offset)) > len(POSES) / 3


def test_ranges_are_set_right() -> None:
    true = observe(scan_at(POSE, noise=0.0))
    wrong = observe(measured(scan_at(POSE, noise=0.0), 0.9, 0.3))
    assert set_right(wrong, 0.9, 0.3).coarse == pytest.approx(true.coarse, abs=1e-4)


def test_what_is_missing_or_empty_stays_so() -> None:
    scan = scan_at(POSE, noise=0.0)
    scan.ranges[10], scan.ranges[20] = float("nan"), float("inf")
    seen = observe(scan)
    right = set_right(seen, 0.9, 0.3)
    assert (np.isnan(right.coarse) == np.isnan(seen.coarse)).all()
    assert (np.isinf(right.coarse) == np.isinf(seen.coarse)).all()


def test_a_list_of_the_whole_map_states_the_check() -> None:
    wide = scan_at(POSE, field_of_view=2 * np.pi)
    core, by_eigenspace = ready(), ready(verification="eigenspace", obstacles="reconstruction")
    fits = receive(core, wide)[0]
    assert fits.HasField("range_check")
    assert not fits.range_check.errors
    assert receive(core, measured(wide, 1.25, 0.0))[0].range_check.errors
    assert not receive(by_eigenspace, wide)[0].HasField("range_check")
