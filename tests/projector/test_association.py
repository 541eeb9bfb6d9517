"""Every association against its direct, slow formula."""

from itertools import combinations
from typing import get_args

import numpy as np
import pytest
from eigenscan.projector.association.cells import CellTable, mean_step
from eigenscan.projector.association.kinds import Kind, association
from eigenscan.projector.association.manifold import Matches, Sheets
from eigenscan.projector.association.patches import triangulate
from eigenscan.projector.association.surfaces import Surfaces
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.association.tetrahedra import Tetrahedra
from eigenscan.projector.association.tree import Trees
from eigenscan.projector.association.triangles import Triangles
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import SURELY_LARGER, explaining, find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.shelf import WholeSet
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.projector.office import free_poses, hear, is_right, poses_of, ready, scan_at, site, tower

Array = NDArray[np.float64]
seeds = st.integers(0, 2**16)
margins = st.sampled_from([0.0, 0.2, 0.5])


def _grid(rng: np.random.Generator, share: float = 0.8) -> NDArray[np.int64]:
    """Cells of a small floor with holes, at least one."""
    there = rng.random((5, 6)) < share
    there[0, 0] = True
    return np.argwhere(there)


def _sheets(rng: np.random.Generator, components: int = 5, headings: int = 7) -> Sheets:
    """A smooth, folded manifold."""
    cells = _grid(rng)
    x, y = (cells * 0.5).T[:, :, None, None]
    turn = np.arange(headings)[None, :, None] * (2 * np.pi / headings)
    waves = rng.normal(0, 2, (3, components))
    coefficients = 4 * np.sin(waves[0] * x + waves[1] * y + turn + waves[2]) + 2 * np.cos(turn + waves[1])
    return Sheets(coefficients.astype(np.float32), cells * 0.5 + [3.0, -2.0], cells)


def _affine(rng: np.random.Generator, headings: int = 8) -> tuple[Sheets, Array, Array]:
    """A manifold that is linear, base + pose @ axes, but for its last heading: a line does not close."""
    cells = np.argwhere(np.ones((4, 4)))
    positions = cells * 0.5
    turn = np.arange(headings) * (2 * np.pi / headings)
    axes, base = rng.normal(0, 3, (3, 6)), rng.normal(0, 3, 6)
    poses = np.concatenate(
        [np.repeat(positions, headings, axis=0), np.tile(turn, len(cells))[:, None]], axis=1
    )
    coefficients = (base + poses @ axes).reshape(len(cells), headings, 6)
    coefficients[:, -1] += 1000.0
    return Sheets(coefficients.astype(np.float32), positions, cells), axes, base


def _direct(regions: list[Sheets], alphas: Array, residuals: Array) -> Array:
    parts = [
        ((r.coefficients.reshape(r.rows, -1) - a) ** 2).sum(axis=1) + e
        for r, a, e in zip(regions, alphas, residuals, strict=True)
    ]
    return np.concatenate(parts)


def _query(rng: np.random.Generator, regions: list[Sheets]) -> tuple[Array, Array]:
    m = regions[0].coefficients.shape[-1]
    return rng.normal(0, 4, (len(regions), m)), rng.uniform(0, 60, len(regions))


@settings(max_examples=50, deadline=None)
@given(seeds, st.integers(1, 3), st.integers(1, 2000), st.integers(1, 9))
def test_the_tree_finds_the_nearest_of_all(seed: int, regions: int, count: int, components: int) -> None:
    rng = np.random.default_rng(seed)
    sheets = [_sheets(rng, components) for _ in range(regions)]
    alphas, residuals = _query(rng, sheets)
    direct = _direct(sheets, alphas, residuals)
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
    sheets = [_sheets(rng, components) for _ in range(regions)]
    table = CellTable.of(sheets)
    # also far outside of all cells
    alphas, residuals = _query(rng, sheets)
    alphas *= rng.choice([0.5, 1.0, 10.0])
    first = np.concatenate([s.coefficients.reshape(s.rows, -1)[:, :3] for s in sheets])
    low = first.min(axis=0)
    cells = np.floor((first - low) / table.side)
    centre = np.clip(np.floor((alphas[:, :3] - low) / table.side), 0, cells.max(axis=0))
    region = np.repeat(np.arange(regions), [s.rows for s in sheets])
    rings = np.abs(cells - centre[region]).max(axis=1)
    wanted = min(count, len(first))
    reach = next(r for r in range(1, 10_000) if np.count_nonzero(rings <= r) >= wanted)
    direct = np.where(rings <= reach, _direct(sheets, alphas, residuals), np.inf)
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
    sheets = [_sheets(rng) for _ in range(regions)]
    alphas, residuals = _query(rng, sheets)
    near = SweepTable.of(sheets).nearest(alphas, residuals, count)
    surfaces = Surfaces.of(sheets)
    found = surfaces.nearest(alphas, residuals, count)
    order = {row: i for i, row in enumerate(near.rows.tolist())}
    rows = {}
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
    other = _query(rng, sheets)
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
    sheets = Sheets(flat, cells * 0.5, cells)
    alpha = rng.normal(20, 20, 4)
    found = Surfaces.of([sheets]).nearest(alpha[None], np.zeros(1), sheets.rows)
    assert sorted(found.rows % 7) == list(range(7))


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_patches_tile_every_square_with_three_corners_or_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sheets = _sheets(rng)
    triangles = triangulate(sheets)
    there = {tuple(c) for c in sheets.cells.tolist()}
    area = 0.0
    for x in range(-1, 6):
        for y in range(-1, 7):
            held = sum((x + dx, y + dy) in there for dx in (0, 1) for dy in (0, 1))
            area += {4: 1.0, 3: 0.5}.get(held, 0.0)
    c = sheets.cells[triangles].astype(float)
    u, v = c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]
    areas = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2
    assert np.allclose(areas, 0.5)
    assert areas.sum() == pytest.approx(area)
    assert len(np.unique(triangles, axis=0)) == len(triangles)


def _volumes(sheets: Sheets) -> tuple[Array, Array]:
    """Rows and turns (n, 4) of the corners of all tetrahedra."""
    headings = sheets.coefficients.shape[1]
    rows, turns = [], []
    for triangle in triangulate(sheets):
        for h in range(headings):
            six = [(p * headings + h, 0) for p in triangle] + [
                (p * headings + (h + 1) % headings, 1) for p in triangle
            ]
            for four in ((0, 3, 4, 5), (0, 1, 4, 5), (0, 1, 2, 5)):
                rows.append([six[k][0] for k in four])
                turns.append([six[k][1] for k in four])
    return np.array(rows).reshape(-1, 4), np.array(turns).reshape(-1, 4)


@settings(max_examples=50, deadline=None)
@given(seeds, margins)
def test_tetrahedra_are_those_that_enclose_the_scan(seed: int, margin: float) -> None:
    rng = np.random.default_rng(seed)
    sheets = _sheets(rng)
    points = sheets.coefficients.reshape(sheets.rows, -1).astype(np.float64)
    # somewhere among the poses
    alpha = points[rng.integers(0, len(points), 3)].mean(axis=0) + rng.normal(0, 0.3, 5)
    rows, turns = _volumes(sheets)
    expected: dict[int, tuple[float, Array]] = {}
    doubtful = set()
    step = 2 * np.pi / 7
    for four, turned in zip(rows, turns, strict=True):
        system = np.vstack([points[four, :3].T, np.ones(4)])
        if abs(np.linalg.det(system)) < 1e-9:
            continue
        weights = np.linalg.solve(system, [*alpha[:3], 1.0])
        own = int(np.argmax(weights))
        if abs(weights.min() + margin) < 1e-4:
            doubtful.add(int(four[own]))
        if weights.min() < -margin:
            continue
        square = float(((weights @ points[four] - alpha) ** 2).sum()) + 2.0
        place = weights @ np.column_stack([sheets.positions[four // 7], turned * step])
        home = [*sheets.positions[four[own] // 7], turned[own] * step]
        if four[own] not in expected or square < expected[four[own]][0]:
            expected[int(four[own])] = square, place - home
    found = Tetrahedra.of([sheets], margin).nearest(alpha[None], np.array([2.0]), 10_000)
    assert set(found.rows) - doubtful == set(expected) - doubtful
    assert np.all(np.diff(found.squares) >= 0)
    for row, square, offset in zip(found.rows, found.squares, found.offsets, strict=True):
        if row not in doubtful:
            assert square == pytest.approx(expected[row][0], rel=1e-3, abs=1e-3)
            assert np.allclose(offset, expected[row][1], atol=1e-3)


@settings(max_examples=50, deadline=None)
@given(seeds, margins)
def test_triangles_are_those_that_the_scan_lies_over(seed: int, margin: float) -> None:
    rng = np.random.default_rng(seed)
    sheets = _sheets(rng)
    points = sheets.coefficients.reshape(sheets.rows, -1).astype(np.float64)
    by_heading = sheets.coefficients.astype(np.float64)[..., :3]
    alpha = points[rng.integers(0, len(points), 3)].mean(axis=0) + rng.normal(0, 0.3, 5)
    expected: dict[int, float] = {}
    doubtful = set()
    for triangle in triangulate(sheets):
        for h in range(7):
            rows = triangle * 7 + h
            corners = points[rows]
            axes = (corners[1:, :3] - corners[0, :3]).T
            two = np.linalg.lstsq(axes, alpha[:3] - corners[0, :3], rcond=None)[0]
            weights = np.array([1 - two.sum(), *two])
            away = np.linalg.norm(axes @ two + corners[0, :3] - alpha[:3])
            steps = [
                np.linalg.norm(by_heading[p, (h + s) % 7] - by_heading[p, h])
                for p in triangle
                for s in (-1, 1)
            ]
            reach = max(steps) * (0.5 + margin)
            own = int(rows[np.argmax(weights)])
            if abs(weights.min() + margin) < 1e-4 or abs(away - reach) < 1e-4:
                doubtful.add(own)
            if weights.min() < -margin or away > reach:
                continue
            square = float(((weights @ corners - alpha) ** 2).sum())
            expected[own] = min(square, expected.get(own, np.inf))
    found = Triangles.of([sheets], margin).nearest(alpha[None], np.zeros(1), 10_000)
    assert set(found.rows) - doubtful == set(expected) - doubtful
    for row, square in zip(found.rows, found.squares, strict=True):
        assert row in doubtful or square == pytest.approx(expected[row], rel=1e-3, abs=1e-3)
    assert np.all(found.offsets[:, 2] == 0)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_interpolation_is_exact_on_an_affine_manifold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sheets, axes, base = _affine(rng)
    headings = sheets.coefficients.shape[1]
    step = 2 * np.pi / headings
    # on a sheet for the patches, between two for the volumes
    pose = np.array([*rng.uniform(0.05, 1.45, 2), rng.integers(0, headings - 2) * step])
    between = pose + np.array([0.0, 0.0, rng.uniform(0.02, 0.98) * step])
    for maker, truth in ((Triangles, pose), (Tetrahedra, between)):
        found = maker.of([sheets], 0.0).nearest((base + truth @ axes)[None], np.zeros(1), 100)
        poses = (
            np.column_stack([sheets.positions[found.rows // headings], (found.rows % headings) * step])
            + found.offsets
        )
        off = np.abs(poses - truth).max(axis=1)
        # the one that fits in all coefficients is the first
        assert off[0] < 1e-3
        assert found.squares[0] < 1e-4
        assert np.all(np.abs(found.offsets[:, :2]) <= 0.5)
        assert np.all(np.abs(found.offsets[:, 2]) <= step)


@pytest.mark.parametrize("kind", get_args(Kind))
def test_a_pruned_region_is_as_if_it_were_not_there(kind: Kind) -> None:
    rng = np.random.default_rng(8)
    sheets = [_sheets(rng) for _ in range(3)]
    alphas, residuals = _query(rng, sheets)
    residuals[1] = np.inf
    found = association(kind, sheets, 0.5).nearest(alphas, residuals, 60)
    region = np.searchsorted(np.cumsum([s.rows for s in sheets]), found.rows, side="right")
    assert len(found.rows)
    assert set(region) <= {0, 2}
    if kind in ("sweep", "tree"):
        direct = np.sort(_direct(sheets, alphas, residuals))[:60]
        # the sweep keeps a byte a coefficient
        assert np.allclose(found.squares, direct, rtol=0.03)


def test_the_mean_step_is_that_of_all_pairs_of_neighbours() -> None:
    sheets = _sheets(np.random.default_rng(4))
    squares = []
    for a, b in combinations(range(len(sheets.cells)), 2):
        if np.abs(sheets.cells[a] - sheets.cells[b]).sum() == 1:
            squares += [*((sheets.coefficients[a] - sheets.coefficients[b])[:, :3] ** 2).sum(axis=1)]
    for p in range(len(sheets.cells)):
        for h in range(7):
            d = sheets.coefficients[p, h] - sheets.coefficients[p, (h + 1) % 7]
            squares.append((d[:3] ** 2).sum())
    assert mean_step([sheets]) == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-5)


def test_matches_of_two_lists_are_one_a_pose() -> None:
    one = Matches(np.array([5, 7, 6, 4]), np.array([1, 2, 3, 6], np.float32), np.eye(4)[:, :3])
    other = Matches.on_grid(np.array([8, 7]), np.array([4, 5], np.float32))
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
def test_every_association_finds_the_pose_of_a_clean_scan(kind: Kind) -> None:
    core = ready(association=kind)
    listed = 0
    for i, truth in enumerate(free_poses(12, 61)):
        poses = poses_of(hear(core, scan_at(truth, noise=0.0, seed=i))[0])
        listed += bool(is_right(poses, truth).any())
    assert listed >= 11


def test_a_scan_outside_of_all_volumes_has_no_hypotheses_and_is_no_fault() -> None:
    core = ready(association="tetrahedra", margin=0.0)
    lengths = []
    for i, truth in enumerate(free_poses(20, 5, tower())):
        message, obstacles = hear(core, scan_at(truth, grid=tower(), range_max=3.0, seed=i))
        lengths.append(len(message.hypotheses))
        assert message.status == Hypotheses.STATUS_OK
        assert (obstacles is None) == (lengths[-1] == 0)
        assert message.unlisted_log_likelihood <= 0.0
    assert min(lengths) == 0


def test_interpolated_poses_are_handed_on() -> None:
    model = site()
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    nearest: dict[str, list[float]] = {"sweep": [], "triangles": [], "tetrahedra": []}
    for kind, found in nearest.items():
        settings_ = ProjectorSettings.model_validate({"association": kind})
        built = Site(whole, settings_)
        for i, truth in enumerate(free_poses(12, 71, clearance=0.6)):
            seen = observe(scan_at(truth, noise=0.0, seed=i))

            def witness(stage: str, poses: Array, truth: Array = truth, found: list[float] = found) -> None:
                if stage == "associated":
                    here = poses[is_right(poses, truth)]
                    found.append(np.hypot(*(here - truth)[:, :2].T).min(initial=1.0))

            find_candidates(built, built.view(seen.sensor), seen, settings_, witness)
    assert np.median(nearest["tetrahedra"]) < 0.5 * np.median(nearest["sweep"])
    assert np.median(nearest["triangles"]) < 0.5 * np.median(nearest["sweep"])


@given(st.lists(st.tuples(st.floats(0.0, 50.0), st.floats(0.01, 50.0)), min_size=1, max_size=9))
def test_pruned_is_what_explains_the_scan_worse_than_its_own_scans_and_than_another_region(
    pairs: list[tuple[float, float]],
) -> None:
    square, usual = np.array(pairs).T
    searched = explaining(square, usual)
    least = min(s / u for s, u in pairs)
    for (s, u), kept in zip(pairs, searched, strict=True):
        assert kept == (s / u <= 1.0 or s / u <= SURELY_LARGER * least)
    assert searched.any()


def test_some_regions_are_pruned_and_none_that_holds_the_pose() -> None:
    core = ready()
    pruned = 0
    for i, truth in enumerate(free_poses(30, 3)):
        message, _ = hear(core, scan_at(truth, field_of_view=2 * np.pi, seed=i))
        searched = {p.region for p in message.projections if p.searched}
        pruned += len(message.projections) - len(searched)
        assert {h.region for h in message.hypotheses} <= searched
        assert is_right(poses_of(message), truth).any()
    assert pruned
