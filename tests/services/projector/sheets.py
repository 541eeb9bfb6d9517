"""Small manifolds for the tests of the associations."""

import numpy as np
from eigenscan.projector.association.manifold import Sheets
from numpy.typing import NDArray

Array = NDArray[np.float64]


def _cells(rng: np.random.Generator, share: float = 0.8) -> NDArray[np.int64]:
    """Cells of a small floor with holes, at least one."""
    there = rng.random((5, 6)) < share
    there[0, 0] = True
    return np.argwhere(there)


def random_sheets(rng: np.random.Generator, components: int = 5, headings: int = 7) -> Sheets:
    """A smooth, folded manifold."""
    cells = _cells(rng)
    x, y = (cells * 0.5).T[:, :, None, None]
    turn = np.arange(headings)[None, :, None] * (2 * np.pi / headings)
    waves = rng.normal(0, 2, (3, components))
    coefficients = 4 * np.sin(waves[0] * x + waves[1] * y + turn + waves[2]) + 2 * np.cos(turn + waves[1])
    return Sheets(coefficients.astype(np.float32), cells * 0.5 + [3.0, -2.0], cells)


def affine_sheets(rng: np.random.Generator, headings: int = 8) -> tuple[Sheets, Array, Array]:
    """A manifold that is linear, base + pose @ axes, but for its last heading: a line does not close."""
    cells = np.argwhere(np.ones((4, 4)))
    positions: np.ndarray = cells * 0.5
    turn = np.arange(headings) * (2 * np.pi / headings)
    axes, base = rng.normal(0, 3, (3, 6)), rng.normal(0, 3, 6)
    poses = np.concatenate(
        [np.repeat(positions, headings, axis=0), np.tile(turn, len(cells))[:, None]], axis=1
    )
    coefficients = (base + poses @ axes).reshape(len(cells), headings, 6)
    coefficients[:, -1] += 1000.0
    return Sheets(coefficients.astype(np.float32), positions, cells), axes, base


def direct_squares(regions: list[Sheets], alphas: Array, residuals: Array) -> Array:
    parts = [
        ((r.coefficients.reshape(r.rows, -1) - a) ** 2).sum(axis=1) + e
        for r, a, e in zip(regions, alphas, residuals, strict=True)
    ]
    return np.concatenate(parts)


def random_query(rng: np.random.Generator, regions: list[Sheets]) -> tuple[Array, Array]:
    m = regions[0].coefficients.shape[-1]
    return rng.normal(0, 4, (len(regions), m)), rng.uniform(0, 60, len(regions))
