"""Two claims of the paper, measured: few components hold a room, and interpolation goes below the grid.

    .venv/bin/python benchmarks/eigenspace.py [--datasets FOLDER] [--json OUT]

variance (section 3): the share of the variance that the first components hold, with the paper's sensor
(half a turn at half a degree, plain ranges up to 50 m); regions by the median. precision (section 5.2): how
far the pose is off that the scan of a place between the grid's poses is associated with: the nearest pose;
with the paper's correction by dx and dy; in the enclosing triangle; in the enclosing tetrahedron, heading
too. Medians over the scans whose first match near the truth is right. The datasets are not part of the
project; by default they are looked for beside it.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from build import office
from eigenscan.eigenspace.components import Eigenspace, all_coefficients, analyse
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.ranges import RangeTransform
from eigenscan.geometry.circle import TURN, difference
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, read_map
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.association.kinds import Kind, association
from eigenscan.projector.association.manifold import Matches, Sheets
from single_scan import DATASETS

BEAMS, HEADINGS, RANGE_MAX = 361, 720, 50.0
SHOWN = (1, 2, 3, 4, 5, 6, 8, 12, 16)
SPACINGS = (1.0, 0.5, 0.25, 0.1)
COMPONENTS, SCANS = 4, 100
CLIP = RangeTransform(RANGE_MAX)


def room() -> GridMap:
    """Rectilinear, 7 m by 5 m, with a niche and a cupboard."""
    cells = np.full((104, 144), OCCUPIED, dtype=np.uint8)
    cells[2:-2, 2:-2] = FREE
    cells[2:22, 2:42] = OCCUPIED
    cells[70:-2, 110:124] = OCCUPIED
    return GridMap(cells, 0.05, np.zeros(3))


def variance(built: SiteModel) -> dict[str, float]:
    """Share of the variance by number of components, median over the regions of 20 positions and more."""
    large = [m for m in built.regions if len(m.index) >= min(20, max(len(r.index) for r in built.regions))]
    spaces = [analyse(CLIP(model.panoramas), BEAMS, count=max(SHOWN)) for model in large]
    held = np.array([np.cumsum(space.eigenvalues) / space.total_variance for space in spaces])
    return {str(count): float(np.median(held[:, count - 1])) for count in SHOWN}


def precision(grid: GridMap, spacing: float, stride: int) -> dict[str, float]:
    """Median errors, m and degrees, in the largest region; headings every `stride` half degrees."""
    model = max(build_site(grid, Plan(spacing=spacing)).regions, key=lambda m: len(m.index))
    space = analyse(CLIP(model.panoramas), BEAMS, count=COMPONENTS)
    every = all_coefficients(CLIP(model.panoramas), space)[:, ::stride]
    sheets = Sheets(every, model.positions, model.index.astype(np.int64))
    truths, alphas = _between(grid, model, space, sheets)
    found = {
        kind: _first_near(sheets, kind, truths, alphas, spacing)
        for kind in ("sweep", "triangles", "tetrahedra")
    }
    found["paper"] = _corrected(sheets, found["sweep"], alphas)
    known = np.all([np.isfinite(poses).all(axis=1) for poses in found.values()], axis=0)
    errors: dict[str, float] = {"judged": float(known.mean())}
    for name, poses in found.items():
        off = np.hypot(*(poses - truths)[known, :2].T)
        errors[f"{name}_m"] = float(np.median(off))
        errors[f"{name}_deg"] = float(np.median(np.degrees(np.abs(difference(poses, truths)[known, 2]))))
    return errors


def _between(
    grid: GridMap, model: RegionModel, space: Eigenspace, sheets: Sheets
) -> tuple[np.ndarray, np.ndarray]:
    """Random poses (n, 3) in squares of four positions, and their scans' coefficients (n, M)."""
    rng = np.random.default_rng(5)
    whole = np.all([sheets.beside(*step) >= 0 for step in ((1, 0), (0, 1), (1, 1))], axis=0)
    at = rng.choice(np.flatnonzero(whole), SCANS)
    points = model.positions[at] + rng.uniform(0, model.spacing, (SCANS, 2))
    truths = np.column_stack([points, rng.uniform(0, TURN, SCANS)])
    bearings = np.arange(BEAMS) * (TURN / HEADINGS)
    return truths, space.project(CLIP(RayCaster.of(grid).cast(truths, bearings, RANGE_MAX)))


def _first_near(
    sheets: Sheets, kind: Kind, truths: np.ndarray, alphas: np.ndarray, spacing: float
) -> np.ndarray:
    """Poses (n, 3) of the best match at most a cell and its neighbours from each truth; NaN without one."""
    index = association(kind, [sheets], 0.5)
    out = np.full((len(truths), 3), np.nan)
    for i, alpha in enumerate(alphas.astype(np.float64)):
        found = index.nearest(alpha[None], np.zeros(1), sheets.rows)
        poses = _poses(sheets, found)
        step = TURN / sheets.coefficients.shape[1]
        near = (np.abs(poses - truths[i])[:, :2] < 2 * spacing).all(axis=1)
        near &= np.abs(difference(poses[:, 2], truths[i, 2])) < max(2 * step, np.deg2rad(6))
        if near.any():
            out[i] = poses[np.argmax(near)]
    return out


def _poses(sheets: Sheets, found: Matches) -> np.ndarray:
    headings = sheets.coefficients.shape[1]
    grid = [sheets.positions[found.rows // headings], (found.rows % headings)[:, None] * (TURN / headings)]
    return np.hstack(grid) + found.offsets


def _corrected(sheets: Sheets, nearest: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """The paper's section 5.2: ratios along the two axes of the square around the nearest pose.

    Of the four squares at the pose the one whose plane comes nearest to the scan.
    """
    headings = sheets.coefficients.shape[1]
    place = {tuple(position): i for i, position in enumerate(np.round(sheets.positions, 6).tolist())}
    right, above = sheets.beside(1, 0), sheets.beside(0, 1)
    out = nearest.copy()
    for i in np.flatnonzero(np.isfinite(nearest).all(axis=1)):
        home = place[tuple(np.round(nearest[i, :2], 6).tolist())]
        h = round(nearest[i, 2] / (TURN / headings)) % headings
        best = np.inf
        left, below = sheets.beside(-1, 0)[home], sheets.beside(0, -1)[home]
        corner = sheets.beside(-1, -1)[home]
        for p in (home, left, below, corner):
            if p < 0 or right[p] < 0 or above[p] < 0:
                continue
            origin = sheets.coefficients[p, h].astype(np.float64)
            axes = np.stack([sheets.coefficients[q, h] - origin for q in (right[p], above[p])])
            ratio = np.clip(axes @ (alphas[i] - origin) / (axes**2).sum(axis=1), 0, 1)
            away = float(np.linalg.norm(alphas[i] - origin - ratio @ axes))
            if away < best:
                best = away
                out[i, :2] = sheets.positions[p] + ratio * np.ptp(sheets.positions[[p, right[p]], 0])
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    maps = {name: read_map(options.datasets / name / "map.yaml") for name in ("intel", "fr079", "guardian")}
    result: dict[str, Any] = {"variance": {}, "precision": []}
    print(" | ".join(["variance %", *map(str, SHOWN)]))
    for name, grid in {"room (simulated)": room(), "office (simulated)": office(470.0), **maps}.items():
        result["variance"][name] = variance(build_site(grid, Plan(spacing=0.5)))
        print(" | ".join([name, *(f"{100 * v:.0f}" for v in result["variance"][name].values())]), flush=True)
    print(
        "\nscene | spacing | headings | nearest | paper's dx, dy | triangle | tetrahedron | heading: nearest"
    )
    for name, grid, stride in (("room", room(), 1), ("room", room(), 12), ("intel", maps["intel"], 12)):
        for spacing in SPACINGS:
            row = precision(grid, spacing, stride)
            result["precision"].append({"scene": name, "spacing": spacing, "step_deg": 0.5 * stride, **row})
            lengths = [
                f"{100 * row[f'{kind}_m']:.1f} cm" for kind in ("sweep", "paper", "triangles", "tetrahedra")
            ]
            turns = f"{row['sweep_deg']:.2f} deg, tetrahedron {row['tetrahedra_deg']:.2f} deg"
            print(" | ".join([name, f"{spacing:.2f} m", f"{0.5 * stride} deg", *lengths, turns]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
