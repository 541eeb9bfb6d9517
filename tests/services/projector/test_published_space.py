"""What the mapbuilder publishes is what is searched."""

from dataclasses import replace

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel

from tests.services.projector.office import (
    Array,
    free_poses,
    is_right,
    poses_of,
    ready,
    receive,
    scan_at,
    site,
)


def _with_noise(model: RegionModel, seed: int) -> RegionModel:
    """The region with another eigenspace, orthonormal but of nothing; its version is that of its content."""
    rng = np.random.default_rng(seed)
    space = model.space.space
    basis, _ = np.linalg.qr(rng.normal(size=(space.vectors[0].size, len(space.vectors))))
    noise = replace(
        space,
        mean=rng.uniform(-1, 1, space.mean.shape).astype(np.float32),
        vectors=np.ascontiguousarray(basis.T, dtype=np.float32).reshape(space.vectors.shape),
        eigenvalues=np.sort(rng.uniform(0.01, 1, len(space.eigenvalues)).astype(np.float32))[::-1].copy(),
    )
    return replace(model, space=replace(model.space, space=noise))


def _noisy(built: SiteModel) -> SiteModel:
    return replace(built, regions=tuple(_with_noise(m, i) for i, m in enumerate(built.regions)))


def _found(built: SiteModel, truths: Array) -> list[Array]:
    core = ready(built, candidates=100)
    return [poses_of(receive(core, scan_at(truth, seed=i))[0]) for i, truth in enumerate(truths)]


def test_noise_in_the_place_of_the_published_eigenspaces_changes_the_poses() -> None:
    truths = free_poses(12, 7)
    published, noisy = _found(site(), truths), _found(_noisy(site()), truths)
    assert sum(np.array_equal(a, b) for a, b in zip(published, noisy, strict=True)) <= 2
    right = [
        sum(bool(len(p) and is_right(p[:1], t)[0]) for p, t in zip(found, truths, strict=True))
        for found in (published, noisy)
    ]
    assert right[0] >= 10
    assert right[1] < right[0]


def test_another_analysis_at_the_mapbuilder_changes_what_is_searched() -> None:
    truths = free_poses(6, 8)
    usual = _found(site(), truths)
    for other in (site(embedding="range"), site(components=3)):
        found = _found(other, truths)
        assert any(not np.array_equal(a, b) for a, b in zip(usual, found, strict=True))
