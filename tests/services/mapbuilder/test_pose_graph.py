from collections.abc import Iterable

import numpy as np
import pytest
from eigenscan.geometry.circle import difference
from eigenscan.geometry.pose import between, compose
from eigenscan.mapbuilder.mapping.pose_graph import Edge, optimise, parts

SMALL = np.diag([0.02, 0.02, 0.01]) ** 2


def loop(count: int = 40, radius: float = 8.0) -> np.ndarray:
    """Poses on a circle, heading along it."""
    angle = np.arange(count) * (2 * np.pi / count)
    poses = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), angle + np.pi / 2])
    return between(poses[0], poses)


def measured(
    poses: np.ndarray,
    pairs: Iterable[tuple[int, int]],
    rng: np.random.Generator | None = None,
    trusted: bool = False,
) -> list[Edge]:
    edges = []
    for first, second in pairs:
        noise = np.zeros(3) if rng is None else rng.multivariate_normal(np.zeros(3), SMALL)
        edges.append(
            Edge(first, second, compose(between(poses[first], poses[second]), noise), SMALL, trusted)
        )
    return edges


def steps(count: int) -> list[tuple[int, int]]:
    return [(k, k + 1) for k in range(count - 1)]


def error(found: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
    metres = np.hypot(*(found - truth)[:, :2].T).max()
    return metres, np.abs(difference(found[:, 2], truth[:, 2])).max()


def test_a_perturbed_graph_is_recovered() -> None:
    truth, rng = loop(), np.random.default_rng(1)
    edges = measured(truth, [*steps(40), (0, 39), (5, 30), (12, 33)], trusted=True)
    start = compose(truth, rng.normal(0, [0.4, 0.4, 0.2], truth.shape))
    start[0] = truth[0]
    found, kept = optimise(start, edges)
    assert kept.all()
    metres, radians = error(found, truth)
    assert metres < 1e-3
    assert radians < 1e-4


def test_a_closure_takes_the_drift_of_the_chain_away() -> None:
    truth, rng = loop(), np.random.default_rng(2)
    chain = measured(truth, steps(40), rng, trusted=True)
    way = [truth[0]]
    for edge in chain:
        way.append(compose(way[-1], edge.pose))
    drifted = np.array(way)
    found, kept = optimise(drifted, [*chain, *measured(truth, [(0, 39), (0, 20)])])
    assert kept.all()
    assert error(found, truth)[0] < 0.5 * error(drifted, truth)[0]


def test_outliers_are_rejected_and_the_rest_is_kept() -> None:
    truth, rng = loop(), np.random.default_rng(3)
    chain = measured(truth, steps(40), rng, trusted=True)
    right = measured(truth, [(0, 39), (1, 38), (4, 36), (10, 30)], rng)
    wrong = [
        Edge(2, 22, np.array([0.2, 0.1, 0.0]), SMALL),
        Edge(7, 28, np.array([1.0, -1.0, 2.0]), SMALL),
    ]
    start = np.array(truth)
    found, kept = optimise(start, [*chain, *right, *wrong])
    assert kept[: len(chain) + len(right)].all()
    assert not kept[-2:].any()
    alone, _ = optimise(start, [*chain, *right])
    assert error(found, alone)[0] < 1e-2
    assert error(found, alone)[1] < 1e-3


def test_parts_that_no_edge_joins_stay_where_they_begin() -> None:
    truth = loop(10)
    edges = measured(truth, [(0, 1), (1, 2), (5, 6), (6, 7)], trusted=True)
    assert len(set(parts(10, edges)[[0, 1, 2]])) == 1
    assert len(set(parts(10, edges))) == 6
    start = compose(truth, [0.0, 0.0, 0.0])
    start[6] += 0.3
    found, _ = optimise(start, edges)
    np.testing.assert_allclose(found, truth, atol=1e-4)


def test_without_the_library_the_error_states_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    from eigenscan.mapbuilder.mapping import pose_graph

    monkeypatch.setattr(pose_graph, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"pip install 'eigenscan-mapbuilder\[mapping\]'"):
        optimise(loop(3), measured(loop(3), steps(3)))
