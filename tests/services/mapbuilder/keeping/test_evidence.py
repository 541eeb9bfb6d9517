from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, GridMap
from eigenscan.mapbuilder.keeping.evidence import DAY_NS, Evidence
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.keeping.view import Marks, View, mark
from hypothesis import given, settings
from hypothesis import strategies as st

# written out, not taken from what is tested: a change there must show here
VIEWS = 3

LENGTH_S = 1800.0
HOUR = 3600
GRID = GridMap(np.full((4, 4), FREE, np.uint8), 0.05, np.zeros(3))
WHOLE = slice(0, 4), slice(0, 4)
CELL = 1, 1
seconds = st.integers(0, 10 * HOUR)


def marks(occupied: bool) -> Marks:
    """A view that struck one cell, or looked through it."""
    one = np.zeros((4, 4), dtype=bool)
    one[CELL] = True
    none = np.zeros((4, 4), dtype=bool)
    return Marks(WHOLE, one, none) if occupied else Marks(WHOLE, none, one)


def report(evidence: Evidence, views: Iterable[tuple[int, bool]]) -> Evidence:
    """Views (seconds, occupied) in their order."""
    for second, occupied in views:
        evidence.turn_to(second * 10**9)
        evidence.add(marks(occupied))
    return evidence


def ended(evidence: Evidence, second: int) -> int:
    evidence.turn_to(second * 10**9)
    return int(evidence.run[CELL])


@given(st.integers(0, 20 * HOUR), st.lists(st.integers(0, HOUR), min_size=1, max_size=200))
def test_what_stands_for_an_hour_is_never_seen_by_four_visits(begin: int, stood: list[int]) -> None:
    views = [(begin + second, True) for second in sorted(stood)]
    assert ended(report(Evidence.of(GRID, LENGTH_S), views), begin + 2 * HOUR) <= 3


@given(st.lists(st.tuples(seconds, st.booleans()), max_size=120))
def test_no_cell_has_more_visits_than_there_were(views: list[tuple[int, bool]]) -> None:
    views = sorted(views)
    evidence = report(Evidence.of(GRID, LENGTH_S), views)
    assert abs(ended(evidence, 12 * HOUR)) <= len({second // 1800 for second, _ in views})


@given(st.lists(seconds, min_size=1, max_size=60), st.data())
def test_robots_whose_clocks_differ_make_no_visits(times: list[int], data: st.DataObject) -> None:
    """One robot's clock is days ahead: whichever speaks when, visits are not more than by one clock."""
    ahead = 3 * DAY_NS // 10**9
    views = [(t + ahead * data.draw(st.integers(0, 1)), True) for t in sorted(times)]
    evidence = report(Evidence.of(GRID, LENGTH_S), views)
    assert ended(evidence, ahead + 12 * HOUR) <= len({second // 1800 for second in times})


def test_a_visit_that_shows_otherwise_starts_again() -> None:
    evidence = Evidence.of(GRID, LENGTH_S)
    for visit in range(3):
        report(evidence, [(visit * 1800, True)] * VIEWS)
    assert ended(evidence, 3 * 1800) == 3
    report(evidence, [(3 * 1800, False)] * VIEWS)
    assert ended(evidence, 4 * 1800) == -1


@pytest.mark.parametrize("views", [[True] * (VIEWS - 1), [True] * VIEWS + [False] * VIEWS])
def test_a_glimpse_or_a_mixed_visit_is_no_evidence(views: list[bool]) -> None:
    assert ended(report(Evidence.of(GRID, LENGTH_S), [(5, occupied) for occupied in views]), 1800) == 0


@given(st.lists(st.tuples(seconds, st.booleans()), max_size=60), st.integers(0, 60))
def test_evidence_goes_on_after_a_restart(
    tmp_path_factory: pytest.TempPathFactory, views: list[tuple[int, bool]], cut: int
) -> None:
    views, store = sorted(views), Store(tmp_path_factory.mktemp("site") / "model")
    store.save(report(Evidence.of(GRID, LENGTH_S), views[:cut]), GRID)
    resumed = report(store.load(GRID, LENGTH_S), views[cut:])
    whole = report(Evidence.of(GRID, LENGTH_S), views)
    assert ended(resumed, 12 * HOUR) == ended(whole, 12 * HOUR)


def test_evidence_of_other_cells_or_a_damaged_file_is_none(tmp_path: Path) -> None:
    store = Store(tmp_path / "model")
    evidence = report(Evidence.of(GRID, LENGTH_S), [(0, True)] * VIEWS)
    store.save(evidence, GRID)
    assert store.load(GRID, LENGTH_S).struck[CELL] == VIEWS
    moved = GridMap(GRID.cells, GRID.resolution, np.array([1.0, 0.0, 0.0]))
    assert not store.load(moved, LENGTH_S).struck.any()
    assert not store.load(GRID, 60.0).struck.any()
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-40])
    assert not store.load(GRID, LENGTH_S).struck.any()


@settings(deadline=None)  # it compiles at first
@given(
    st.floats(-3.0, 8.0),
    st.floats(-3.0, 8.0),
    st.floats(-3.1, 3.1),
    st.floats(-3.1, 3.1),
    st.integers(0, 2**32 - 1),
)
def test_a_look_marks_the_cells_on_its_beams_and_no_others(
    x: float, y: float, theta: float, turn: float, seed: int
) -> None:
    """On a map at any place and turn, also where beams leave it."""
    grid = GridMap(np.zeros((90, 110), np.uint8), 0.05, np.array([0.3, -0.2, turn]))
    rng = np.random.default_rng(seed)
    view = View(0, np.array([x, y, theta]), rng.uniform(-np.pi, np.pi, 40), rng.uniform(0.05, 6.0, 40))
    found = mark(view, grid, rng.random(40) < 0.5)
    struck, crossed = np.zeros(grid.cells.shape, bool), np.zeros(grid.cells.shape, bool)
    struck[found.part], crossed[found.part] = found.struck, found.crossed
    assert not (struck & crossed).any()
    column, row = np.floor(grid.to_grid(view.points())).astype(int).T
    inside = (row >= 0) & (row < 90) & (column >= 0) & (column < 110)
    expected = np.zeros_like(struck)
    expected[row[inside], column[inside]] = True
    np.testing.assert_array_equal(struck, expected)
    rows, columns = np.nonzero(crossed)
    middles = grid.to_map(np.column_stack([columns + 0.5, rows + 0.5]))
    aims = view.points() - view.pose[:2]
    aims /= np.linalg.norm(aims, axis=1, keepdims=True)
    to = middles - view.pose[:2]
    along = np.clip(to @ aims.T, 0.0, view.ranges)
    nearest = np.linalg.norm(to[:, None] - along[..., None] * aims, axis=2).min(axis=1, initial=np.inf)
    assert (nearest <= 0.05 * np.sqrt(0.5) + 1e-6).all()
