"""Principal components against a supervised projection: which finds the right pose among the nearest?

    .venv/bin/python benchmarks/discriminant.py [--datasets FOLDER] [--scans 100] [--occlude 0.3] [--json OUT]

Principal components are best for reconstruction, not necessarily for localization (Kroese, Vlassis and
Bunschoten). The discriminant directions have the largest variance over a region for what they vary from one
pose to its neighbours on the grid, plus noise as large as the mean variance of a beam; both covariances are
block Toeplitz and exact. Shown is the share of the scans whose right pose is among the n nearest.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from association import Asked, hits, recorded, whole
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.projector.association.manifold import Sheets
from eigenscan.projector.association.sweep import SweepTable
from eigenscan.projector.channel_space import ChannelSpace, ChannelSpaces, analyse_channels, coefficients
from eigenscan.projector.connectivity import lattice_poses
from eigenscan.projector.observation import ANALYSIS_TURN
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import HEADING_STRIDE, Site
from scipy import fft
from scipy.linalg import eigh
from single_scan import DATASETS

COMPONENTS, NEAREST = (3, 8, 16), (1, 10, 100, 1000, 3000)


def discriminant(
    channels: np.ndarray, sheets: Sheets, own: np.ndarray, beams: int, count: int
) -> ChannelSpace:
    """Basis of the `count` directions that tell poses apart best; `own`: the searched positions."""
    space = analyse_channels(channels, beams, count)
    centred = channels - space.mean[:, None, None]
    between = _covariance(centred, beams)
    steps = [centred - np.roll(centred, HEADING_STRIDE, axis=2)]
    steps += [centred[:, own[one]] - centred[:, own[other]] for one, other in sheets.links() if len(one)]
    within = sum(_covariance(step, beams) for step in steps) / len(steps)
    noise = np.trace(between) / len(between)
    size = len(between)
    _, vectors = eigh(
        between, within + noise * np.eye(size), subset_by_index=(size - min(count, size), size - 1)
    )
    basis, _ = np.linalg.qr(vectors[:, ::-1])
    variances = np.einsum("im,ij,jm->m", basis, between, basis)
    return ChannelSpace(
        space.mean,
        np.ascontiguousarray(basis.T).reshape(-1, len(channels), beams),
        variances,
        space.total_variance,
    )


def _covariance(channels: np.ndarray, beams: int) -> np.ndarray:
    """Of all windows of panoramas (F, P, N) with mean 0."""
    many, positions, turn = channels.shape
    spectrum = fft.rfft(channels, axis=2)
    lag = fft.irfft(np.einsum("fpk,gpk->fgk", spectrum, np.conj(spectrum)), turn, axis=2) / (turn * positions)
    apart = (np.arange(beams)[:, None] - np.arange(beams)) % turn
    covariance: np.ndarray = lag[:, :, apart].transpose(0, 2, 1, 3).reshape(many * beams, many * beams)
    return covariance


def judge(built: SiteModel, scans: list[Asked], count: int, supervised: bool) -> list[float]:
    """Shares of the scans by NEAREST."""
    site = Site(whole(built), ProjectorSettings(components=count))
    view, lattice = site.view(scans[0].seen.sensor), site.lattice
    beams = view.spaces.vectors.shape[-1]
    spaces, regions = [], []
    for own, searched, cells in zip(lattice.regions, lattice.searched, lattice.cells, strict=True):
        channels = view.embedding(lattice.panoramas[own])
        sheets = Sheets(np.empty((len(searched), 0, 0), np.float32), lattice.positions[searched], cells)
        at = np.array([np.flatnonzero(own == position)[0] for position in searched])
        space = (
            discriminant(channels, sheets, at, beams, count)
            if supervised
            else analyse_channels(channels, beams, count)
        )
        spaces.append(space)
        sampled = coefficients(channels[:, at], space, HEADING_STRIDE)
        regions.append(Sheets(sampled, sheets.positions, cells))
    table, projecting = SweepTable.of(regions), ChannelSpaces.of(spaces)
    found = [_found(site, view, table, projecting, one) for one in scans]
    shares: list[float] = np.mean(found, axis=0).tolist()
    return shares


def _found(site: Site, view: Any, table: SweepTable, spaces: ChannelSpaces, one: Asked) -> list[bool]:
    seen = one.seen
    channels = view.embedding(np.where(seen.used, seen.coarse, np.float32(0)))
    alphas, squares = spaces.project(channels, seen.used)
    rows = table.nearest(alphas, squares * (view.embedding.channels * len(seen.coarse)), NEAREST[-1]).rows
    position, window = (of[rows].astype(np.int64) for of in (view.row_position, view.row_window))
    at = lattice_poses(site.lattice.positions, position, window, ANALYSIS_TURN, seen.sensor.angle_min)
    hit = hits(at, one.truth)
    return [bool(hit[:n].any()) for n in NEAREST]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--scans", type=int, default=100)
    parser.add_argument("--occlude", type=float, default=0.0, help="share of the beams, in random runs")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    print(" | ".join(["case", "components", "projection", *(f"{n} nearest %" for n in NEAREST)]))
    for case in ("intel", "fr079", "guardian 3", "guardian 2 rear"):
        built, scans = recorded(options.datasets, case, options.scans, options.occlude)
        for count in COMPONENTS:
            for name in ("principal", "discriminant"):
                shares = judge(built, scans, count, name == "discriminant")
                rows.append({"case": case, "components": count, "projection": name, "found": shares})
                print(" | ".join([case, str(count), name, *(f"{100 * s:.0f}" for s in shares)]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
