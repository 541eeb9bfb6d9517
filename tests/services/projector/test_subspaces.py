"""A scan in all regions' eigenspaces against direct, slow formulas."""

import numpy as np
import pytest
from eigenscan.eigenspace.components import analyse
from eigenscan.projector.subspaces import Subspaces
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.eigenspace.test_components import panoramas


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**16), st.integers(0, 11))
def test_projection_without_the_missing_beams_is_regularised_least_squares(seed: int, missing: int) -> None:
    rng = np.random.default_rng(seed)
    spaces = [analyse(panoramas(2, 4, 24, seed + r), 12, count=5) for r in range(3)]
    scan = rng.normal(size=(2, 12)).astype(np.float32)
    seen = np.ones(12, dtype=bool)
    seen[rng.choice(12, missing, replace=False)] = False
    alpha, square, part = Subspaces.of(spaces).project(scan, seen)
    for r, space in enumerate(spaces):
        basis = space.vectors[:, :, seen].reshape(5, -1).T
        target = (scan[:, seen] - space.mean[:, None]).ravel()
        rows = np.vstack([basis, np.diag(np.sqrt(space.noise / space.eigenvalues))])
        direct, *_ = np.linalg.lstsq(rows, np.concatenate([target, np.zeros(5)]), rcond=None)
        # the vectors are in single precision
        assert np.allclose(alpha[r], direct, atol=1e-4)
        assert square[r] == pytest.approx(np.mean((target - basis @ direct) ** 2), abs=1e-5)
        other = rng.normal(size=5)
        error = part.energy[r] - 2.0 * other @ part.target[r] + other @ part.gram[r] @ other
        assert error == pytest.approx(np.sum((target - basis @ other) ** 2), abs=1e-4)
