"""A reference in another frame than the map is found by the one transform of all claims."""

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.workbench.evaluation.figures import windows_figures
from eigenscan.workbench.evaluation.frames import other_frame
from eigenscan.workbench.evaluation.metrics import Judged, judge
from eigenscan.workbench.evaluation.reference import NS, Trajectory

from tests.workbench.evaluation.test_metrics import stream

MOVED = np.array([3.0, -12.0, np.deg2rad(177.0)])


def window(seed: int, frame: np.ndarray, wrong: int = 0) -> Judged:
    """Thirty claims somewhere in a building, seen in `frame`; the last ones are wrong."""
    rng = np.random.default_rng(seed)
    start = np.array([*rng.uniform(-40.0, 40.0, 2), rng.uniform(-np.pi, np.pi)])
    way = np.column_stack([0.2 * np.arange(30), np.zeros(30), 0.02 * np.arange(30)])
    truth = Trajectory(np.arange(30) * (NS // 10), compose(start, way))
    claimed = compose(frame, truth.poses) + rng.normal(0.0, [0.05, 0.05, 0.01], (30, 3))
    claimed[30 - wrong :, :2] += rng.uniform(5.0, 9.0, (wrong, 2))
    return judge(stream(truth, claimed - truth.poses, [True] * 30), truth)


@pytest.mark.parametrize("wrong", [0, 2])
def test_a_reference_of_another_frame_is_placed_in_the_map(wrong: int) -> None:
    found = windows_figures([window(seed, MOVED, wrong) for seed in range(5)], [])["reference_frame"]
    assert found["x_m"] == pytest.approx(3.0, abs=0.1)
    assert found["y_m"] == pytest.approx(-12.0, abs=0.1)
    assert found["heading_deg"] == pytest.approx(177.0, abs=0.3)
    assert found["right_share"] == pytest.approx(1.0 - wrong / 30)


@pytest.mark.parametrize(
    "judged",
    [
        [],
        [window(seed, np.zeros(3)) for seed in range(4)],
        [window(seed, MOVED) for seed in range(2)],
        [window(seed, np.random.default_rng(seed).uniform(-9.0, 9.0, 3)) for seed in range(8)],
        [window(seed, MOVED if seed % 2 else np.zeros(3)) for seed in range(8)],
    ],
    ids=["no claim", "the map's own", "a place or two", "each at another place", "half are right"],
)
def test_claims_that_no_one_transform_mends_are_no_other_frame(judged: list[Judged]) -> None:
    assert other_frame(judged) is None
