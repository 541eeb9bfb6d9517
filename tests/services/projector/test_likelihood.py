"""What a scan's support at a pose is worth, by how much the scan shows."""

import numpy as np
import pytest
from eigenscan.projector.likelihood import log_likelihood

SUPPORTS = np.array([0.9, 0.5, 0.1])


@pytest.mark.parametrize(("beams", "share"), [(15, 1 / 3), (45, 1.0), (180, 1.0)])
def test_a_scan_of_under_a_quarter_turn_counts_in_proportion(beams: int, share: float) -> None:
    """A quarter turn is 45 beams, 2 degrees apart; fewer are worth less of what a whole turn is."""
    whole = log_likelihood(SUPPORTS, 0.3, 180)
    assert log_likelihood(SUPPORTS, 0.3, beams) == pytest.approx(share * whole)
    assert whole[0] > 0.0 > whole[2]
