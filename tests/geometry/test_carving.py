import numpy as np
import pytest
from eigenscan.geometry.carving import Carving
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN
from hypothesis import given, settings
from hypothesis import strategies as st

coordinates = st.floats(-3.0, 3.0)
points = st.tuples(coordinates, coordinates)


@settings(max_examples=60, deadline=None)
@given(st.tuples(points, points))
def test_a_ray_passes_the_cells_that_it_runs_through_and_hits_the_one_that_it_ends_in(
    ends: tuple[tuple[float, float], tuple[float, float]],
) -> None:
    start, end = np.array(ends[0]), np.array(ends[1])
    carving = Carving.around([start, end], 0.25)
    carving.add(start, end[None])
    last = tuple(np.floor((end - carving.low) / 0.25).astype(int)[::-1])
    assert carving.hits[last] == 1
    assert carving.hits.sum() == 1
    # the slow way: points along the ray; a corner may be passed on either side
    along = (start + np.linspace(0, 1, 4001)[:, None] * (end - start) - carving.low) / 0.25
    passed = np.argwhere(carving.passes)[:, ::-1]
    outside = np.abs(along[None] - passed[:, None] - 0.5).max(axis=-1).min(axis=-1) - 0.5
    assert (outside < 0.01).all()
    cells, inside = np.unique(np.floor(along).astype(int), axis=0, return_counts=True)
    crossed = {tuple(cell) for cell, count in zip(cells, inside, strict=True) if count > 10}
    assert crossed <= {tuple(cell) for cell in passed} | {last[::-1]}
    assert carving.passes.max() <= 1


def test_counts_decide_and_what_no_ray_reached_is_unknown() -> None:
    carving = Carving.around([[0, 0], [2, 0], [2, 1]], 0.1)
    view = np.array([0.05, 0.05])
    for _ in range(3):
        carving.add(view, [[1.55, 0.05]])
    for _ in range(20):
        carving.add(view, [[1.95, 0.05]])
    carving.add(view, [[1.95, 0.95]])
    grid = carving.to_map()
    assert grid.at([1.95, 0.05]) == OCCUPIED
    assert grid.at([1.55, 0.05]) == FREE  # 3 hits of 23: someone walked by
    assert grid.at([1.95, 0.95]) == UNKNOWN  # hit only once
    assert grid.at([1.0, 0.05]) == FREE
    assert grid.at([0.05, 0.95]) == UNKNOWN


@pytest.mark.parametrize("resolution", [0.05, 0.1])
def test_the_grid_is_aligned_with_the_frame(resolution: float) -> None:
    carving = Carving.around([[-0.31, 0.72], [1.0, 1.0]], resolution)
    np.testing.assert_allclose(carving.low / resolution, np.round(carving.low / resolution), atol=1e-9)
    carving.add([-0.31, 0.72], [[1.0, 1.0]])  # both ends are on it
