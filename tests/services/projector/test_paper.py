"""The paper's own way from a scan to hypotheses and mask: sections 5.2 and 6, beside formulas written out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from eigenscan.projector.association.manifold import Matches, Sheets
from eigenscan.projector.association.ratios import Ratios
from eigenscan.projector.core import ProjectorCore
from eigenscan.schemas.methods import of_service

from tests.services.projector.office import free_poses, is_right, poses_of, ready, receive, scan_at, site


@pytest.fixture(scope="module")
def paper() -> ProjectorCore:
    settings: dict[str, Any] = dict(of_service("paper", "projector"))
    return ready(site(), **settings)


def bent_sheets(seed: int) -> Sheets:
    """4 x 5 positions half a metre apart, 6 headings, on a bent manifold of three coefficients."""
    cells = np.array([[x, y] for x in range(4) for y in range(5)])
    rng = np.random.default_rng(seed)
    axes, bend = rng.normal(size=(2, 3)), rng.normal(scale=0.1, size=(6, 3))
    plane = cells @ axes
    coefficients = plane[:, None] + bend * (1.0 + plane[:, None] ** 2)
    return Sheets(coefficients.astype(np.float32), 0.5 * cells + 3.0, cells)


@pytest.mark.parametrize("seed", range(20))
def test_ratios_are_section_5_2_written_out(seed: int) -> None:
    sheets, rng = bent_sheets(seed), np.random.default_rng(seed)
    x, y = int(rng.integers(0, 3)), int(rng.integers(0, 4))
    heading = int(rng.integers(0, 6))
    share, turned = rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, 1.0)
    at = {tuple(cell): number for number, cell in enumerate(sheets.cells.tolist())}
    step = 2.0 * np.pi / 6

    def scan(i: int, j: int) -> np.ndarray:
        place = sheets.coefficients[at[i, j]].astype(float)
        return (1.0 - turned) * place[heading] + turned * place[(heading + 1) % 6]

    p0, along_x, along_y = scan(x, y), scan(x + 1, y) - scan(x, y), scan(x, y + 1) - scan(x, y)
    alpha = p0 + share @ np.stack([along_x, along_y]) + rng.normal(scale=0.02, size=3)
    dx, dy = (float(np.clip((alpha - p0) @ axis / (axis @ axis), 0.0, 1.0)) for axis in (along_x, along_y))
    expected = sheets.positions[at[x, y]] + 0.5 * np.array([dx, dy])
    # whichever corner of the cell was associated, with where its volume has the scan
    for i, j in ((0, 0), (1, 0), (0, 1), (1, 1)):
        home = at[x + i, y + j]
        inside = np.array([0.25, 0.25]) - 0.5 * np.array([i, j])
        found = Matches(
            np.array([home * 6 + heading]),
            np.zeros(1, dtype=np.float32),
            np.array([[*inside, turned * step]]),
        )
        better = Ratios.of([sheets]).interpolate(found, alpha[None])
        assert sheets.positions[home] + better.offsets[0, :2] == pytest.approx(expected, abs=1e-5)
        assert better.offsets[0, 2] == found.offsets[0, 2]
        assert better.rows == found.rows


def test_at_the_edge_of_the_grid_a_match_stays() -> None:
    sheets = bent_sheets(1)
    found = Matches(np.array([19 * 6]), np.zeros(1, dtype=np.float32), np.array([[0.1, 0.2, 0.0]]))
    better = Ratios.of([sheets]).interpolate(found, np.zeros((1, 3)))
    assert better.offsets == pytest.approx(found.offsets)


def test_the_right_pose_is_listed_with_the_grids_covariance(paper: ProjectorCore) -> None:
    truths = free_poses(40, 5)
    held = 0
    for seed, truth in enumerate(truths):
        listed, _ = receive(paper, scan_at(truth, seed=seed))
        held += bool(is_right(poses_of(listed), truth).any())
        for each in listed.hypotheses:
            c = each.covariance
            assert (c.xx, c.xy, c.yy) == pytest.approx((0.25, 0.0, 0.25))
            assert c.tt == pytest.approx(np.deg2rad(6.0) ** 2)
    assert held >= 0.8 * len(truths)


def test_what_stands_before_the_reconstruction_is_masked(paper: ProjectorCore) -> None:
    """Of beams that end two metres early most are obstacles, of the others few."""
    found, wrong, hidden, shown = 0, 0, 0, 0
    for seed, truth in enumerate(free_poses(30, 6)):
        scan = scan_at(truth, seed=seed)
        ranges = np.array(scan.ranges)
        blocked = np.zeros(len(ranges), dtype=bool)
        blocked[40:60] = ranges[40:60] > 3.0
        ranges[blocked] -= 2.0
        scan.ranges[:] = ranges.tolist()
        _, obstacles = receive(paper, scan)
        if obstacles is None:
            continue
        mask = np.frombuffer(obstacles.mask, dtype=np.uint8)
        seen = mask != 255
        found, hidden = found + np.sum((mask == 0) & blocked & seen), hidden + np.sum(blocked & seen)
        wrong, shown = wrong + np.sum((mask == 0) & ~blocked & seen), shown + np.sum(~blocked & seen)
        assert len(obstacles.map_x) == np.sum(mask == 0)
    assert hidden > 100
    assert found / hidden > 3.0 * wrong / shown
