"""Triangles, tetrahedra and interpolation against solving each one by itself."""

import numpy as np
import pytest
from eigenscan.projector.association.manifold import Sheets
from eigenscan.projector.association.patches import triangulate
from eigenscan.projector.association.tetrahedra import Tetrahedra
from eigenscan.projector.association.triangles import Triangles
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.services.projector.sheets import affine_sheets, random_sheets

Array = NDArray[np.float64]
seeds = st.integers(0, 2**16)
margins = st.sampled_from([0.0, 0.2, 0.5])


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_patches_tile_every_square_with_three_corners_or_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sheets = random_sheets(rng)
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
    sheets = random_sheets(rng)
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
    sheets = random_sheets(rng)
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
    sheets, axes, base = affine_sheets(rng)
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
