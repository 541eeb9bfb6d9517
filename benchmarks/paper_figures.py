"""Figures 2, 5, 6, 7 and 9 of the paper, from real scans and cast rays.

    .venv/bin/python benchmarks/paper_figures.py [--datasets FOLDER] [--pictures docs/images] [--json OUT]

2: scans of an office of fr079, without poses or order, as one composite. 5: a tetrahedron of poses and its
image in eigenspace. 6, 7: hypotheses of a real scan of intel in the paper's space, at equal recall. 9: a
square room with a niche and without one, through the cores of projector and tracker.
"""

import argparse
import json
import os
from pathlib import Path
from typing import Any

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, Analysis, coarse_sensor, region_space
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.panorama import Sensor
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap, read_map
from eigenscan.geometry.pose import between, compose, from_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.cloud import Outline
from eigenscan.mapbuilder.mapping.composite import composite
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.projector.connectivity import best_of_neighbourhoods, lattice_poses
from eigenscan.projector.model_set_assembler import WholeSet
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.projection import project
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import Site
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.methods import of_service
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.evaluation.metrics import errors, right
from eigenscan.workbench.evaluation.reference import Trajectory, read_trajectory
from eigenscan.workbench.evaluation.windows import read_times, thin
from eigenscan.workbench.logs import LogOptions
from eigenscan.workbench.simulation.square_room import START, drive, is_near, square_room
from evaluate import DATASETS
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIRST_SCAN, EVERY, SCANS = 3270, 15, 10
"""Of fr079, figure 2: numbers in the log, of a stretch in which the robot turns about in one office."""
TETRAHEDRON = (2.5, 3.0, 0.5, 6.0)
"""Figure 5: x, y, m, spacing, m, and degrees between headings, in the square room."""
LISTED = 100
"""Scans of intel, figures 6 and 7."""
SHOWN, SEEDS = (3, 5, 15, 26), range(6)
"""Observations of figure 9, and the drives that the figures are of."""
WAYS = {"drawn": START, "another": (1.2, 2.0, 0.7), "along the diagonal": (1.4, 1.0, 0.75)}
"""Where drives of figure 9 begin, m, m, rad; a scan on the diagonal is its own mirror image."""
WRONG, RIGHT, TRUTH = "#c0392b", "#1e8449", "#1f4e9c"
MARGIN = float(of_service("paper", "projector")["margin"])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS, help="folder that holds the datasets")
    parser.add_argument("--pictures", type=Path, help="draw into this folder")
    parser.add_argument("--json", type=Path, help="write all figures here")
    given = parser.parse_args()
    found = {
        "composite": figure_2(given.datasets / "fr079", given.pictures),
        "tetrahedron": figure_5(given.pictures),
        "volumes": figures_6_7(given.datasets / "intel", given.pictures),
        "square_room": figure_9(given.pictures),
    }
    print(json.dumps(found, indent=1))
    if given.json:
        given.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def _log_and_reference(folder: Path) -> tuple[Log, Trajectory]:
    log = read_log(folder / "log.clf.gz", LogOptions(), lambda _: None)
    return log, read_trajectory(folder / "log.tum", 0.0).restamped(log.logged)


def figure_2(folder: Path, pictures: Path | None) -> dict[str, Any]:
    """Composite of real scans; the reference only judges where they were put."""
    log, reference = _log_and_reference(folder)
    raw = [each for each in log.whole if each.channel == SCAN_RAW]
    raw = raw[FIRST_SCAN : FIRST_SCAN + EVERY * SCANS : EVERY]
    sweeps = []
    for number, envelope in enumerate(raw):
        scan = log.canonical(envelope)
        assert scan is not None
        bearings = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        sweeps.append(Sweep(number, Outline.of(np.array(scan.ranges), bearings), from_message(scan.mount)))
    made = composite(sweeps)
    truth, _ = reference.at([raw[number].stamp for number in made.numbers])
    off = np.hypot(*(between(truth[0], truth) - between(made.poses[0], made.poses))[:, :2].T)
    if pictures:
        figure, axis = plt.subplots(figsize=(7, 5.4))
        _draw_map(axis, made.grid)
        c, s = np.cos(made.poses[:, 2]), np.sin(made.poses[:, 2])
        axis.quiver(*made.poses[:, :2].T, c, s, color=TRUTH, scale=22, width=0.008, zorder=3)
        axis.set_title(f"{len(made.numbers)} scans, put together without poses or order")
        _save(figure, pictures / "figure_2.png")
    return {
        "scans": SCANS,
        "joined": len(made.numbers),
        "largest_error_m": float(off.max()),
        "free_m2": made.grid.free_area,
    }


def figure_5(pictures: Path | None) -> dict[str, Any]:
    """Four neighbouring poses, the straight edges between their scans, and the scans from between them."""
    x, y, spacing, degrees = TETRAHEDRON
    grid = square_room(niche=True)
    caster = RayCaster.of(grid)
    sensor = coarse_sensor(Sensor(-np.pi / 2, np.deg2rad(2.0), 91, 50.0))
    mapbuilder = MapbuilderSettings.model_validate(of_service("paper", "mapbuilder"))
    rows, columns = np.nonzero(grid.cells == FREE)
    inside = grid.to_map(np.column_stack([columns, rows]) + 0.5)
    places = np.unique(np.round(inside / spacing) * spacing, axis=0)
    places = places[(places > 0.1).all(axis=1) & (places < 7.9).all(axis=1)]
    analysis = Analysis(mapbuilder.plan.analysis.embedding, sensor.beams, mapbuilder.components)
    everywhere = caster.panoramas(places, ANALYSIS_TURN, 50.0)
    space, _ = region_space(everywhere, np.arange(len(places)), analysis)

    def project_poses(poses: Array) -> Array:
        bearings = sensor.angle_min + np.arange(sensor.beams) * sensor.angle_increment
        scans = np.stack([caster.cast(pose, bearings, 50.0)[0] for pose in poses])
        channels = space.embedding(scans)[0] - space.space.mean[0]
        return np.asarray(channels @ space.space.vectors[:, 0].T, dtype=np.float64)

    turn = np.deg2rad(degrees)
    corners = np.array([[x, y, 0.3], [x + spacing, y, 0.3], [x, y + spacing, 0.3], [x, y, 0.3 + turn]])
    images = project_poses(corners)
    edges = [(i, j) for i in range(4) for j in range(i)]
    share = np.linspace(0.0, 1.0, 21)[:, None]
    bends = []
    curves = []
    for i, j in edges:
        curve = project_poses(corners[i] + share * (corners[j] - corners[i]))
        straight = images[i] + share * (images[j] - images[i])
        bends.append(np.linalg.norm(curve - straight, axis=1).max() / np.linalg.norm(images[i] - images[j]))
        curves.append(curve)
    if pictures:
        figure = plt.figure(figsize=(11, 5))
        left = figure.add_subplot(1, 2, 1, projection="3d")
        for axis, points in ((left, corners * [1, 1, 180 / np.pi]),):
            for i, j in edges:
                axis.plot(*points[[i, j]].T, color=TRUTH)
            axis.scatter(*points.T, color=TRUTH, s=40)
        left.set(xlabel="x, m", ylabel="y, m", zlabel="heading, °", title="Four poses")
        eigen = figure.add_subplot(1, 2, 2, projection="3d")
        for (i, j), curve in zip(edges, curves, strict=True):
            eigen.plot(*images[[i, j]].T, color=TRUTH)
            eigen.plot(*curve.T, color=WRONG, linestyle=":")
        eigen.scatter(*images.T, color=TRUTH, s=40)
        eigen.set(xlabel="α₀", ylabel="α₁", zlabel="α₂", title="Their scans; dotted: the poses between them")
        _save(figure, pictures / "figure_5.png")
    return {"largest_bend_of_an_edge": float(max(bends)), "median": float(np.median(bends))}


def figures_6_7(folder: Path, pictures: Path | None) -> dict[str, Any]:
    """Hypotheses of real scans: the nearest poses, and volumes, at equal recall."""
    log, reference = _log_and_reference(folder)
    settings = MapbuilderSettings.model_validate(of_service("paper", "mapbuilder"))
    grid = read_map(folder / "map.yaml")
    model = build_site(grid, settings.plan)
    scans, truths = [], []
    for time in thin(read_times(folder / "single_scans.csv", 0.0), LISTED):
        found = log.nearest_scan(time, 0.5)
        scan = None if found is None else log.canonical(found.envelope)
        if found is None or scan is None:
            continue
        truth, known = reference.at([found.stamp])
        if known[0]:
            scans.append(observe(scan))
            truths.append(compose(truth[0], from_message(scan.mount)))
    volumes = _lists(model, scans, {"association": "tetrahedra", "margin": MARGIN})
    nearest = _lists(model, scans, {"association": "sweep"})
    recall = float(np.mean([_hits(p, t).any() for p, t in zip(volumes, truths, strict=True)]))
    needed = [
        int(np.argmax(h)) + 1 if (h := _hits(p, t)).any() else 10**6
        for p, t in zip(nearest, truths, strict=True)
    ]
    count = int(np.quantile(needed, recall, method="higher"))
    nearest = [poses[:count] for poses in nearest]
    wrong = {
        name: np.array([int((~_hits(p, t)).sum()) for p, t in zip(lists, truths, strict=True)])
        for name, lists in (("nearest", nearest), ("volumes", volumes))
    }
    if pictures:
        both = [
            bool(_hits(a, t).any() and _hits(b, t).any())
            for a, b, t in zip(nearest, volumes, truths, strict=True)
        ]
        off = sum(np.abs(np.log((each + 1) / (np.median(each) + 1))) for each in wrong.values())
        i = int(np.argmin(np.where(both, off, np.inf)))
        figure, axes = plt.subplots(1, 2, figsize=(14, 7))
        titles = ("Figure 6: the nearest poses", "Figure 7: volumes that enclose the scan")
        for axis, title, poses in zip(axes, titles, (nearest[i], volumes[i]), strict=True):
            hit = _hits(poses, truths[i])
            _draw_map(axis, grid)
            for part, colour in ((poses[~hit], WRONG), (poses[hit], RIGHT)):
                axis.quiver(
                    *part[:, :2].T,
                    np.cos(part[:, 2]),
                    np.sin(part[:, 2]),
                    color=colour,
                    scale=35,
                    width=0.004,
                )
            axis.plot(*truths[i][:2], "o", color=TRUTH, markersize=16, fillstyle="none", markeredgewidth=2.5)
            axis.set_title(f"{title}: {int((~hit).sum())} wrong")
        _save(figure, pictures / "figure_6_7.png")
    return {
        "scans": len(scans),
        "recall": recall,
        "false_nearest": float(wrong["nearest"].mean()),
        "false_volumes": float(wrong["volumes"].mean()),
    }


def _lists(model: SiteModel, scans: list[Observation], changes: dict[str, Any]) -> list[Array]:
    """Sensor poses of each scan in the paper's space, nearest first, one of a neighbourhood."""
    whole = WholeSet("", model.frame_id, model.grid, tuple(model.regions), model.grid.free_area)
    site = Site(whole, ProjectorSettings.model_validate(changes))
    lists = []
    for seen in scans:
        view = site.view(seen.sensor).complete()
        projected = project(view, seen, seen.used)
        squares = projected.error_energy**2 * len(seen.coarse)
        squares[~projected.searched] = np.inf
        found = view.association.nearest(projected.coefficients, squares, 100_000).best(100_000)
        position, window = view.places(found.rows)
        poses = lattice_poses(site.lattice.positions, position, window, ANALYSIS_TURN, seen.sensor.angle_min)
        poses = poses + found.offsets
        lists.append(poses[best_of_neighbourhoods(poses, np.arange(len(poses)), 0.5, np.deg2rad(10), 20_000)])
    return lists


def _hits(poses: Array, truth: Array) -> NDArray[np.bool_]:
    return np.asarray(right(*errors(poses, np.tile(truth, (len(poses), 1)))), dtype=np.bool_)


def figure_9(pictures: Path | None) -> dict[str, Any]:
    """Probabilities of the right path after some observations, on several ways; one drive's picture."""
    if pictures:
        figure, axes = plt.subplots(2, len(SHOWN), figsize=(16, 8.4))
        for row, niche in zip(axes, (True, False), strict=True):
            moments = {moment.number: moment for moment in drive(niche, seed=SEEDS[0])}
            for axis, number in zip(row, SHOWN, strict=True):
                _draw_moment(axis, niche, moments[number])
        _save(figure, pictures / "figure_9.png")
    return {way: _ways(start) for way, start in WAYS.items()}


def _ways(start: tuple[float, float, float]) -> dict[str, Any]:
    """Mean over drives of the right path's probability in either room, and the largest of any path in one."""
    reported: dict[str, Any] = {"drives": len(SEEDS)}
    for room, niche, method in (
        ("niche", True, "paper"),
        ("square", False, "paper"),
        ("verified", False, ""),
    ):
        changes = {} if method else {"tracker": {"method": "paper"}}
        drives = [
            {
                moment.number: moment.probabilities
                for moment in drive(niche, method or "default", seed, start, changes)
            }
            for seed in SEEDS
        ]
        reported[room] = {str(n): float(np.mean([each[n][0] for each in drives])) for n in SHOWN}
        reported[room]["largest"] = max(max(moment) for each in drives for moment in each.values())
    return reported


def _draw_moment(axis: Any, niche: bool, moment: Any) -> None:
    _draw_map(axis, square_room(niche))
    for track in sorted(moment.tracks.tracks, key=lambda each: each.probability):
        if track.probability < 0.02:
            continue
        way = np.array([[pose.x, pose.y] for pose in track.history])
        colour = RIGHT if is_near(from_message(track.pose), moment.truth) else WRONG
        axis.plot(*way.T, color=colour, alpha=min(1.0, 0.25 + track.probability), marker=".", linewidth=1.5)
        axis.annotate(
            f"{track.probability:.2f}", way[-1], textcoords="offset points", xytext=(4, 4), color=colour
        )
    axis.plot(*moment.truth[:2], "o", color=TRUTH, markersize=12, fillstyle="none", markeredgewidth=2)
    axis.set_title(f"{moment.number} observations", fontsize=13)


def _draw_map(axis: Any, grid: GridMap) -> None:
    height, width = (size * grid.resolution for size in grid.cells.shape)
    x, y, _ = grid.origin
    shade = np.where(grid.cells == OCCUPIED, 0.0, np.where(grid.cells == FREE, 1.0, 0.85))
    axis.imshow(shade, cmap="gray", vmin=0, vmax=1, origin="lower", extent=(x, x + width, y, y + height))
    axis.set_axis_off()


def _save(figure: Any, path: Path) -> None:
    figure.tight_layout()
    figure.savefig(path, dpi=80)
    plt.close(figure)


if __name__ == "__main__":
    main()
