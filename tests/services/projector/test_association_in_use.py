"""Every association in the whole projector, and the pruning of regions before it."""

from typing import get_args

import numpy as np
import pytest
from eigenscan.projector.association.kinds import Kind
from eigenscan.projector.association.manifold import Matches
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import explaining, find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.services.projector.office import (
    free_poses,
    is_right,
    poses_of,
    ready,
    receive,
    scan_at,
    site,
    tower,
)

# written out, not taken from what is tested: a change there must show here
SURELY_LARGER = 2.0

Array = NDArray[np.float64]


@pytest.mark.parametrize("kind", get_args(Kind))
def test_every_association_finds_the_pose_of_a_clean_scan(kind: Kind) -> None:
    core = ready(association=kind)
    listed = 0
    for i, truth in enumerate(free_poses(12, 61)):
        poses = poses_of(receive(core, scan_at(truth, noise=0.0, seed=i))[0])
        listed += bool(is_right(poses, truth).any())
    assert listed >= 11


def test_a_scan_outside_of_all_volumes_has_no_hypotheses_and_is_no_fault() -> None:
    core = ready(association="tetrahedra", margin=0.0)
    lengths = []
    for i, truth in enumerate(free_poses(20, 5, tower())):
        message, obstacles = receive(core, scan_at(truth, grid=tower(), range_max=3.0, seed=i))
        lengths.append(len(message.hypotheses))
        assert message.status == Hypotheses.STATUS_OK
        assert (obstacles is None) == (lengths[-1] == 0)
        assert message.unlisted_log_likelihood <= 0.0
    assert min(lengths) == 0


def test_interpolated_poses_are_handed_on() -> None:
    model = site()
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    nearest: dict[str, list[float]] = {"sweep": [], "triangles": [], "tetrahedra": []}
    for kind, found in nearest.items():
        settings_ = ProjectorSettings.model_validate({"association": kind})
        built = Site(whole, settings_)
        for i, truth in enumerate(free_poses(12, 71, clearance=0.6)):
            seen = observe(scan_at(truth, noise=0.0, seed=i))

            def trace(stage: str, poses: Array, truth: Array = truth, found: list[float] = found) -> None:
                if stage == "associated":
                    here = poses[is_right(poses, truth)]
                    found.append(np.hypot(*(here - truth)[:, :2].T).min(initial=1.0))

            find_candidates(built, built.view(seen.sensor), seen, settings_, trace)
    assert np.median(nearest["tetrahedra"]) < 0.5 * np.median(nearest["sweep"])
    assert np.median(nearest["triangles"]) < 0.5 * np.median(nearest["sweep"])


@given(st.lists(st.tuples(st.floats(0.0, 50.0), st.floats(0.01, 50.0)), min_size=1, max_size=9))
def test_pruned_is_what_explains_the_scan_worse_than_its_own_scans_and_than_another_region(
    pairs: list[tuple[float, float]],
) -> None:
    square, usual = np.array(pairs).T
    searched = explaining(square, usual)
    least = min(s / u for s, u in pairs)
    for (s, u), kept in zip(pairs, searched, strict=True):
        assert kept == (s / u <= 1.0 or s / u <= SURELY_LARGER * least)
    assert searched.any()


def test_some_regions_are_pruned_and_none_that_holds_the_pose() -> None:
    core = ready()
    pruned = 0
    for i, truth in enumerate(free_poses(30, 3)):
        message, _ = receive(core, scan_at(truth, field_of_view=2 * np.pi, seed=i))
        searched = {p.region for p in message.projections if p.searched}
        pruned += len(message.projections) - len(searched)
        assert {h.region for h in message.hypotheses} <= searched
        assert is_right(poses_of(message), truth).any()
    assert pruned


@pytest.mark.parametrize(
    ("rows", "squares", "words"),
    [
        ([-1], [1.0], "rows -1 to -1, of poses 0 to"),
        ([10**9], [1.0], "rows 1000000000 to"),
        ([0, 1], [1.0], "squares (1,)"),
        ([0.5], [1.0], "rows (1,) float64"),
        ([0], [np.nan], "not finite"),
    ],
)
def test_what_is_no_match_is_an_error_and_no_crash(
    rows: list[float], squares: list[float], words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A row out of range ended the process, without a line."""
    wrong = Matches(np.array(rows), np.array(squares, np.float32))
    monkeypatch.setattr(SweepTable, "nearest", lambda *_: wrong)
    core = ready(association="sweep")
    with pytest.raises(ValueError, match="an association gave") as raised:
        receive(core, scan_at(free_poses(1, 61)[0]))
    assert words in str(raised.value)
