"""From a lidar's own grid to the poses' coefficients: each step against its direct formula, for any lidar."""

import numpy as np
import pytest
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, coarse_sensor
from eigenscan.eigenspace.embedding import Kind
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.projector.association.tree import Trees
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import observe
from eigenscan.projector.projection import project
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.scan_pb2 import Scan
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.services.projector.office import site

# written out, not taken from what is tested: a change there must show here
NEAREST = 0.25

STEP = 2 * np.pi / ANALYSIS_TURN


def _site(embedding: Kind, components: int) -> Site:
    model = site(embedding=embedding, components=components)
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    return Site(whole, ProjectorSettings(association="tree"))


@settings(max_examples=100, deadline=None)
@given(
    st.floats(0.1, 5.0),
    st.floats(2.0, 360.0),
    st.floats(-np.pi, np.pi),
    st.floats(0.0, 1.0),
    st.integers(0, 2**16),
)
def test_a_scan_of_any_step_and_field_of_view_is_seen_along_its_nearest_beams(
    step_deg: float, view_deg: float, angle_min: float, missing: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    step = np.deg2rad(step_deg)
    beams = int(view_deg / step_deg) + 1
    ranges = rng.uniform(0.1, 30.0, beams)
    ranges[rng.random(beams) < missing] = rng.choice([np.nan, np.inf])
    scan = Scan(angle_min=angle_min, angle_increment=step, range_max=30.0, ranges=ranges.tolist())
    seen = observe(scan)
    span = (beams - 1) * step
    assert len(seen.coarse) == min(round(span / STEP + 1e-9) + 1, ANALYSIS_TURN)
    for j, r in enumerate(seen.coarse):
        away = np.abs(np.arange(beams) * step - j * STEP)
        nearest = np.flatnonzero(away < away.min() + 1e-6)
        if away.min() > step / 2 + 1e-6:
            # past the last beam nothing is known
            assert np.isnan(r)
            continue
        wanted = np.where(ranges[nearest] < NEAREST, np.nan, ranges[nearest]).astype(np.float32)
        assert any(np.array_equal(r, w, equal_nan=True) for w in wanted)
        bearings = angle_min + nearest * step
        assert np.abs(bearings - seen.bearings[j]).min() < 1e-9


@pytest.mark.parametrize("embedding", ["ring", "range"])
@pytest.mark.parametrize(
    ("step_deg", "view_deg", "range_max"), [(0.25, 180, 80), (0.36, 240, 5.6), (2.0, 360, 12), (1.7, 31, 0)]
)
def test_every_pose_lies_where_its_own_scan_is_projected(
    embedding: Kind, step_deg: float, view_deg: float, range_max: float
) -> None:
    built = _site(embedding, 7)
    step = np.deg2rad(step_deg)
    sensor = Sensor(0.3, step, min(round(view_deg / step_deg) + 1, round(360 / step_deg)), range_max)
    view, beams = built.view(sensor).complete(), coarse_sensor(sensor).beams
    assert isinstance(view.association, Trees)
    rng = np.random.default_rng(2)
    for r, tree in enumerate(view.association.trees):
        for row in rng.integers(0, tree.n, 20):
            at = view.bounds[r] + row
            position, first = view.places(np.array([at]))
            window = built.lattice.panoramas[position[0], (first + np.arange(beams)) % ANALYSIS_TURN]
            away = view.embedding(window) - view.spaces.mean[r][:, None]
            direct = [np.sum(v.astype(np.float64) * away) for v in view.spaces.vectors[r]]
            assert np.allclose(tree.data[row], direct, atol=2e-3)
            seen = observe(_scan(sensor, window))
            if not seen.used.all():
                continue
            projected = project(view, seen, seen.used)
            # eigenvectors are orthonormal: each coefficient is held by its own variance alone
            held = np.array(direct) / (1 + view.spaces.prior[r])
            error = away - np.einsum("m,mfj->fj", held, view.spaces.vectors[r])
            assert np.allclose(projected.coefficients[r], held, atol=2e-3)
            assert projected.error_energy[r] == pytest.approx(np.sqrt(np.mean(error**2)), abs=2e-3)


def _scan(sensor: Sensor, window: np.ndarray) -> Scan:
    """The window as a scan of the sensor at the analysis step."""
    return Scan(
        angle_min=sensor.angle_min,
        angle_increment=STEP,
        range_max=sensor.range_max,
        ranges=window.tolist(),
    )
