"""The paper's figure 9: four symmetric hypotheses in a square room, until what breaks the symmetry tells."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from tests.environment import ROOT

SCRIPT = ROOT / "benchmarks/tracking.py"


@pytest.fixture(scope="module")
def tracking() -> ModuleType:
    spec = importlib.util.spec_from_file_location("tracking", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("method", ["mixture", "paper"])
@pytest.mark.parametrize("seed", [9, 10, 11, 12])
def test_the_right_trajectory_is_confirmed(tracking: ModuleType, method: str, seed: int) -> None:
    panels = {number: (truth, tracks) for number, truth, tracks in tracking.figure_9(method, seed)}
    _, early = panels[3]
    alive = [track.probability for track in early.tracks if track.probability > 0.05]
    assert len(alive) >= 3
    assert max(alive) < 0.75
    truth, late = panels[26]
    best = late.tracks[0]
    assert best.probability > 0.95
    assert np.hypot(best.pose.x - truth[0], best.pose.y - truth[1]) < 0.1
    # it is one trajectory, from low-left to upper-right
    assert best.history[0].x < 2.0
    assert best.history[0].y < 2.0
    assert len(best.history) == 26


def test_the_scans_settle_it_little_by_little(tracking: ModuleType) -> None:
    shares = {}
    for number, truth, tracks in tracking.figure_9("mixture", 9):
        near = [
            t.probability for t in tracks.tracks if np.hypot(t.pose.x - truth[0], t.pose.y - truth[1]) < 0.2
        ]
        shares[number] = sum(near)
    assert shares[3] < shares[15]
    # once it is settled it stays so
    assert min(shares[15], shares[26]) > 0.95
