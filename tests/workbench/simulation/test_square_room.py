"""The paper's figure 9 through the projector's and the tracker's cores: four poses, until a niche shows."""

from __future__ import annotations

import numpy as np
import pytest
from eigenscan.workbench.simulation.square_room import OBSERVATIONS, Moment, drive, quarter_turns, square_room

SEEDS = (9, 10, 11)
Settings = dict[str, object]


def moments(
    niche: bool, seed: int, method: str = "paper", tracker: Settings | None = None
) -> dict[int, Moment]:
    driven = drive(niche, method, seed, changes={"tracker": tracker or {}})
    found = {moment.number: moment for moment in driven}
    assert len(found) == OBSERVATIONS
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_the_niche_confirms_the_right_path(seed: int) -> None:
    seen = moments(True, seed)
    # at first all four poses are hypotheses, and none is believed
    assert seen[1].listed == [True] * 4
    assert max(seen[3].probabilities) < 0.5
    assert seen[3].probabilities[0] < seen[15].probabilities[0] < seen[26].probabilities[0]
    assert seen[26].probabilities[0] > 0.9
    # one trajectory leads from the lower left to the upper right
    best = seen[26].tracks.tracks[0]
    assert np.hypot(best.pose.x - seen[26].truth[0], best.pose.y - seen[26].truth[1]) < 0.3
    assert len(best.history) == OBSERVATIONS
    assert np.hypot(best.history[0].x - seen[1].truth[0], best.history[0].y - seen[1].truth[1]) < 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_without_a_niche_no_path_is_claimed(seed: int) -> None:
    """What differs between the four is how the grid's volumes hold the scan; it is not evidence enough."""
    for moment in moments(False, seed).values():
        assert max(moment.probabilities) < 0.7


@pytest.mark.parametrize("settings", [{"method": "mixture"}, {"method": "paper"}])
def test_verified_hypotheses_leave_four_as_they_are(settings: Settings) -> None:
    """Neither tracker makes evidence of a room that is perfectly square."""
    for moment in moments(False, 9, "default", tracker=settings).values():
        assert max(moment.probabilities) - min(moment.probabilities) < 0.05


def test_the_room_looks_alike_from_four_poses_but_for_its_niche() -> None:
    square, with_niche = square_room(niche=False), square_room(niche=True)
    assert np.array_equal(square.cells, np.rot90(square.cells))
    assert not np.array_equal(with_niche.cells, np.rot90(with_niche.cells))
    four = quarter_turns(np.array([1.0, 2.0, 0.0]))
    assert four[:, :2] == pytest.approx(np.array([[1.0, 2.0], [6.0, 1.0], [7.0, 6.0], [2.0, 7.0]]))
