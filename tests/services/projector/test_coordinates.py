"""The coordinates of a hypothesis in eigenspace, against the inner products one by one."""

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.projector.coordinates import coordinates
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import observe
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site

from tests.services.projector.office import free_poses, is_right, poses_of, ready, receive, scan_at, site


def test_they_are_those_of_the_nearest_pose_of_the_model() -> None:
    model = site(components=5)
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    built = Site(whole, ProjectorSettings())
    seen = observe(scan_at(free_poses(1, 2)[0]))
    view, lattice = built.view(seen.sensor).complete(), built.lattice
    poses = free_poses(20, 3)
    region = np.arange(20) % len(built.regions)
    found = coordinates(view, lattice, poses, region, seen.sensor.angle_min)
    vectors, mean = view.spaces.vectors[region], view.spaces.mean[region]
    for pose, r_vectors, r_mean, own in zip(poses, vectors, mean, found, strict=True):
        nearest = np.argmin(np.hypot(*(lattice.positions - pose[:2]).T))
        first = round((pose[2] + seen.sensor.angle_min) / (2 * np.pi) * ANALYSIS_TURN)
        scan = [lattice.panoramas[nearest, (first + j) % ANALYSIS_TURN] for j in range(len(seen.coarse))]
        away = view.embedding(np.array(scan)) - r_mean[:, None]
        assert np.allclose(own, [np.sum(vector * away) for vector in r_vectors], atol=1e-3)


def test_where_the_model_has_a_position_the_scan_and_its_pose_lie_together() -> None:
    core, model = ready(), site().regions[0]
    together = []
    for p in range(0, len(model.positions), 7):
        truth = np.array([*model.positions[p], np.deg2rad(20.0)])
        message, _ = receive(core, scan_at(truth, noise=0.0))
        scan = {p.region: np.array(p.coefficients) for p in message.projections}
        first = message.hypotheses[0]
        if is_right(poses_of(message)[:1], truth)[0]:
            own = scan[first.region]
            together.append(np.linalg.norm(np.array(first.coefficients) - own) / np.linalg.norm(own))
    assert len(together) >= 5
    assert np.median(together) < 0.1
