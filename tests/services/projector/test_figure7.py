"""Figures 6 and 7 of the paper: volumes that enclose the scan give fewer false hypotheses than near poses."""

import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN
from eigenscan.projector.association.kinds import Kind
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.projection import project
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from numpy.typing import NDArray

from tests.services.projector.office import free_poses, is_right, scan_at, site

Array = NDArray[np.float64]
ALL = 10**6


def _listed(kind: Kind, scans: list[Observation]) -> list[Array]:
    """All hypotheses of each scan in the paper's space, nearest first."""
    model = site(embedding="range", components=3)
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    built = Site(whole, ProjectorSettings(association=kind, margin=0.25))
    view = built.view(scans[0].sensor).complete()
    lists = []
    for seen in scans:
        projected = project(view, seen, seen.used)
        squares = projected.error_energy**2 * len(seen.coarse)
        found = view.association.nearest(projected.coefficients, squares, ALL).best(ALL)
        position, window = view.places(found.rows)
        grid = lattice_poses(built.lattice.positions, position, window, ANALYSIS_TURN, seen.sensor.angle_min)
        lists.append(grid + found.offsets)
    return lists


def _false(poses: Array, truth: Array) -> int:
    """Neighbourhoods that are not the scan's."""
    kept = best_of_neighbourhoods(poses, np.arange(len(poses)), 0.5, np.deg2rad(10), len(poses))
    return int(np.count_nonzero(~is_right(poses[kept], truth)))


def test_volumes_give_fewer_false_hypotheses_at_equal_recall() -> None:
    truths = free_poses(120, 17)
    scans = [observe(scan_at(truth, seed=i)) for i, truth in enumerate(truths)]
    volumes, nearest = _listed("tetrahedra", scans), _listed("sweep", scans)
    recall = np.mean([is_right(p, t).any() for p, t in zip(volumes, truths, strict=True)])
    assert recall > 0.9
    # as many nearest poses as it takes to hold the right one as often
    needed = [np.argmax(is_right(p, t)) + 1 for p, t in zip(nearest, truths, strict=True)]
    count = int(np.quantile(needed, recall, method="higher"))
    false_near = np.mean([_false(p[:count], t) for p, t in zip(nearest, truths, strict=True)])
    false_volumes = np.mean([_false(p, t) for p, t in zip(volumes, truths, strict=True)])
    assert false_volumes < 0.75 * false_near
