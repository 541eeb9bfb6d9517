"""Associations with the nearest poses against their direct, slow formulas."""

from itertools import combinations
from typing import get_args

import numpy as np
import pytest
from eigenscan.projector.association.cells import CellTable, mean_step
from eigenscan.projector.association.kinds import Kind, association
from eigenscan.projector.association.manifold import Matches, Sheets
from eigenscan.projector.association.surfaces import Surfaces
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.association.tree import Trees
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.services.projector.sheets import direct_squares, random_query, random_sheets

seeds = st.integers(0, 2**16)


@settings(max_examples=50, deadline=None)
@given(seeds, st.integers(1, 3), st.integers(1, 2000), st.integers(1, 9))
def test_the_tree_finds_the_nearest_of_all(seed: int, regions: int, count: int, components: int) -> None:
    rng = np.random.default_rng(seed)
    sheets = [random_sheets(rng, components) for _ in range(regions)]
    alphas, residuals = random_query(rng, sheets)
    direct = direct_squares(sheets, alphas, residuals)
    found = Trees.of(sheets).nearest(alphas, residuals, count)
    assert len(np.unique(found.rows)) == len(found.rows) == min(count, len(direct))
    assert np.allclose(found.squares, np.sort(direct)[:count], rtol=1e-4)
    assert np.allclose(direct[found.rows], found.squares, rtol=1e-4)


@settings(max_examples=50, deadline=None)
@given(seeds, st.integers(1, 3), st.integers(1, 2000), st.integers(1, 5))
def test_the_cells_give_the_nearest_of_the_poses_around(
    seed: int, regions: int, count: int, components: int
) -> None:
    rng = np.random.default_rng(seed)
    sheets = [random_sheets(rng, components) for _ in range(regions)]
    table = CellTable.of(sheets)
    # also far outside of all cells
    alphas, residuals = random_query(rng, sheets)
    alphas *= rng.choice([0.5, 1.0, 10.0])
    first = np.concatenate([s.coefficients.reshape(s.rows, -1)[:, :3] for s in sheets])
    low = first.min(axis=0)
    cells = np.floor((first - low) / table.side)
    centre = np.clip(np.floor((alphas[:, :3] - low) / table.side), 0, cells.max(axis=0))
    region = np.repeat(np.arange(regions), [s.rows for s in sheets])
    rings = np.abs(cells - centre[region]).max(axis=1)
    wanted = min(count, len(first))
    reach = next(r for r in range(1, 10_000) if np.count_nonzero(rings <= r) >= wanted)
    direct = np.where(rings <= reach, direct_squares(sheets, alphas, residuals), np.inf)
    found = table.nearest(alphas, residuals, count)
    assert len(np.unique(found.rows)) == len(found.rows) == wanted
    assert np.allclose(direct[found.rows], np.sort(direct)[:wanted], rtol=1e-3)
    assert np.allclose(found.squares, direct[found.rows], rtol=1e-3)


@settings(max_examples=50, deadline=None)
@given(seeds, st.integers(1, 3), st.integers(1, 400))
def test_connectivity_keeps_the_nearest_of_each_surface_and_no_other(
    seed: int, regions: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    sheets = [random_sheets(rng) for _ in range(regions)]
    alphas, residuals = random_query(rng, sheets)
    near = SweepTable.of(sheets).nearest(alphas, residuals, count).best(count)
    surfaces = Surfaces.of(sheets)
    found = surfaces.nearest(alphas, residuals, count)
    order = {row: i for i, row in enumerate(near.rows.tolist())}
    rows: dict[tuple[int, int, int, int], int] = {}
    before = 0
    for r, s in enumerate(sheets):
        for p, (x, y) in enumerate(s.cells.tolist()):
            rows |= {(r, h, x, y): before + p * 7 + h for h in range(7)}
        before += s.rows
    kept = []
    for (r, h, x, y), row in rows.items():
        beside = [rows.get((r, h, x + dx, y + dy), -1) for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        if row in order and all(order[row] < order.get(other, count + 1) for other in beside):
            kept.append(row)
    assert found.rows.tolist() == sorted(kept, key=lambda row: order[row])
    assert found.squares.tolist() == [near.squares[order[row]] for row in found.rows]
    # nothing is left over from the scan before
    other = random_query(rng, sheets)
    fresh = Surfaces.of(sheets).nearest(*other, count)
    assert surfaces.nearest(*other, count).rows.tolist() == fresh.rows.tolist()


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_connectivity_keeps_exactly_one_pose_of_a_flat_sheet(seed: int) -> None:
    rng = np.random.default_rng(seed)
    cells = np.argwhere(np.ones((5, 4)))
    # axes at right angles: of all poses but one a neighbour is nearer to the scan; whole numbers up to the
    # largest, so that packing into bytes loses nothing
    x, y, turn = rng.integers(1, 9, 3)
    flat = np.full((len(cells), 7, 4), 127.0, dtype=np.float32)
    flat[..., 0], flat[..., 1] = (cells * [x, y]).T[..., None]
    flat[..., 2] = np.arange(7) * turn
    positions: np.ndarray = cells * 0.5
    sheets = Sheets(flat, positions, cells)
    alpha = rng.normal(20, 20, 4)
    found = Surfaces.of([sheets]).nearest(alpha[None], np.zeros(1), sheets.rows)
    assert sorted(found.rows % 7) == list(range(7))


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_pruned_region_is_as_if_it_were_not_there(kind: Kind) -> None:
    rng = np.random.default_rng(8)
    sheets = [random_sheets(rng) for _ in range(3)]
    alphas, residuals = random_query(rng, sheets)
    residuals[1] = np.inf
    found = association(kind, sheets, 0.5).nearest(alphas, residuals, 60)
    region = np.searchsorted(np.cumsum([s.rows for s in sheets]), found.rows, side="right")
    assert len(found.rows)
    assert set(region) <= {0, 2}
    if kind in ("sweep", "tree"):
        direct = np.sort(direct_squares(sheets, alphas, residuals))[:60]
        # the sweep keeps a byte a coefficient
        assert np.allclose(found.squares, direct, rtol=0.03)


def test_the_mean_step_is_that_of_all_pairs_of_neighbours() -> None:
    sheets = random_sheets(np.random.default_rng(4))
    squares = []
    for a, b in combinations(range(len(sheets.cells)), 2):
        if np.abs(sheets.cells[a] - sheets.cells[b]).sum() == 1:
            squares += [*((sheets.coefficients[a] - sheets.coefficients[b])[:, :3] ** 2).sum(axis=1)]
    for p in range(len(sheets.cells)):
        for h in range(7):
            d = sheets.coefficients[p, h] - sheets.coefficients[p, (h + 1) % 7]
            squares.append((d[:3] ** 2).sum())
    assert mean_step([sheets]) == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-5)


def test_rows_are_sorted_up_to_the_last_that_a_site_can_have() -> None:
    rows = np.random.default_rng(2).integers(0, 2**31, 500)
    found = Matches(rows, np.zeros(500, np.float32)).sorted_rows
    assert found.dtype == np.int64
    assert found.tolist() == sorted(rows.tolist())


def test_matches_of_two_lists_are_one_a_pose() -> None:
    one = Matches(np.array([5, 7, 6, 4]), np.array([1, 2, 3, 6], np.float32), np.eye(4)[:, :3])
    other = Matches(np.array([8, 7]), np.array([4, 5], np.float32))
    both = one.joined(other).by_row()
    assert both.rows.tolist() == [4, 5, 6, 7, 8]
    assert both.squares.tolist() == [6, 1, 3, 2, 4]
    assert both.offsets.tolist() == [*np.eye(4)[[3, 0, 2, 1], :3].tolist(), [0, 0, 0]]


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_site_of_one_position_has_no_neighbours_and_is_no_fault(kind: Kind) -> None:
    sheets = Sheets(np.ones((1, 6, 2), np.float32), np.zeros((1, 2)), np.zeros((1, 2), int))
    found = association(kind, [sheets], 0.5).nearest(np.ones((1, 2)), np.zeros(1), 10)
    assert len(found.rows) == {"triangles": 0, "tetrahedra": 0}.get(kind, 6)


@pytest.mark.parametrize("kind", get_args(Kind))
def test_the_square_of_a_pose_is_its_distance_from_the_scan(kind: Kind) -> None:
    rng = np.random.default_rng(9)
    sheets = [random_sheets(rng) for _ in range(3)]
    alphas, residuals = random_query(rng, sheets)
    direct = direct_squares(sheets, alphas, residuals)
    found = association(kind, sheets, 0.5).nearest(alphas, residuals, 60)
    found.check(len(direct))
    assert len(found.rows)
    if found.between is None:
        assert np.allclose(
            found.squares, direct[found.rows], rtol=0.03
        )  # the sweep keeps a byte a coefficient
    else:  # of what lies between poses, the scan is no farther than what is analysed of both
        assert (found.squares >= residuals.min()).all()
