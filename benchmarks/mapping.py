"""Maps from whole logs: `eigenscan map` with odometry and without, judged by what it never sees.

    .venv/bin/python benchmarks/mapping.py [--datasets FOLDER] [--only intel] [--localize] [--json OUT]

Relations: errors of the relative poses that were checked by hand (Kümmerle et al. 2009). Trajectory: the
distance to the reference after the one rigid alignment that fits best. Localize: another run of the same
building, evaluated on the map that was made and on the given one. The datasets are not part of the project;
by default they are looked for beside it.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from eigenscan.geometry.pose import between, compose, inverse, transform
from eigenscan.workbench.evaluation.reference import NS, Trajectory, read_trajectory
from numpy.typing import NDArray

EIGENSCAN = Path(sys.executable).parent / "eigenscan"
DATASETS = Path(__file__).parents[1].parent / "shared/datasets"
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """One log; `truth`: relations, or a TUM trajectory. `other`: a second run of the building and its TUM."""

    name: str
    folder: str
    log: str
    truth: str
    other: tuple[str, str] | None = None


CASES = (
    Case("intel", "intel", "intel.clf.bz2", "intel.relations"),
    Case("fr079", "fr079", "fr079.clf.bz2", "fr079.relations"),
    Case("intel, reference", "intel", "log.clf.gz", "log.tum"),
    Case("fr079, reference", "fr079", "log.clf.gz", "log.tum"),
    Case(
        "jarvis",
        "jarvis",
        "jarvis_circular_path_fast.bag",
        "jarvis_circular_path_fast.tum",
        ("jarvis_complex_path_fast.bag", "jarvis_complex_path_fast.tum"),
    ),
    Case("jarvis complex", "jarvis", "jarvis_complex_path_fast.bag", "jarvis_complex_path_fast.tum"),
    Case(
        "guardian 3",
        "guardian",
        "guardian_3.bag",
        "guardian_3.tum",
        ("guardian_controller_2.bag", "guardian_controller_2.tum"),
    ),
    Case("guardian 2", "guardian", "guardian_controller_2.bag", "guardian_controller_2.tum"),
    Case("olin", "olin_mac", "rosbag2", "rosbag2.tum"),
)


def main() -> None:
    options = _options()
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        for case in CASES:
            if (
                case.folder not in (options.only or [case.folder])
                or not (options.datasets / case.folder).exists()
            ):
                continue
            for odometry in (True, False):
                target = Path(scratch) / f"{case.name}{odometry}.yaml".replace(" ", "_")
                rows.append(_run(case, options.datasets / case.folder, odometry, target))
                if options.localize and case.other and odometry:
                    rows[-1]["localized"] = _localize(
                        case, case.other, options.datasets / case.folder, target
                    )
                print(_line(rows[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--datasets", type=Path, default=DATASETS, help="folder that holds the datasets")
    parser.add_argument("--only", action="append", help="folder of one dataset; may be given again")
    parser.add_argument("--localize", action="store_true", help="also localize on the maps that were made")
    parser.add_argument("--json", type=Path, help="write all figures here")
    options = parser.parse_args()
    print(
        "| log | odometry | judged by | n | cm, mean | median | max | deg, mean | max | s | times as fast |"
    )
    print("|" + "---|" * 11)
    return options


def _run(case: Case, folder: Path, odometry: bool, target: Path) -> dict[str, Any]:
    command: list[str | Path] = [EIGENSCAN, "map", folder / case.log, "-o", target]
    began = time.perf_counter()
    subprocess.run(
        [*command, *([] if odometry else ["--no-odometry"])],
        check=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    took = time.perf_counter() - began
    found = read_trajectory(target.with_suffix(".tum"))
    truth = folder / case.truth
    errors = _relations(found, truth) if truth.suffix == ".relations" else _trajectory(found, truth)
    metres, degrees = np.hypot(errors[:, 0], errors[:, 1]), np.rad2deg(np.abs(errors[:, 2]))
    return {
        "log": case.name,
        "odometry": odometry,
        "judged_by": truth.name,
        "n": len(errors),
        "metres": {"mean": metres.mean(), "median": float(np.median(metres)), "max": metres.max()},
        "degrees": {"mean": degrees.mean(), "median": float(np.median(degrees)), "max": degrees.max()},
        "seconds": took,
        "recorded_seconds": float(np.ptp(found.stamps)) / NS,
    }


def _relations(found: Trajectory, path: Path) -> Array:
    """Errors (n, 3) of relative poses, each seen from the true one."""
    table = np.loadtxt(path)
    poses = []
    for column in (0, 1):
        stamps = np.round(table[:, column] * 1e6).astype(np.int64) * 1000
        nearest = np.clip(np.searchsorted(found.stamps, stamps), 1, len(found.stamps) - 1)
        before = stamps - found.stamps[nearest - 1] < found.stamps[nearest] - stamps
        nearest -= before
        assert np.abs(found.stamps[nearest] - stamps).max() < 0.01 * NS
        poses.append(found.poses[nearest])
    return between(table[:, [2, 3, 7]], between(*poses))


def _trajectory(found: Trajectory, path: Path) -> Array:
    """Errors (n, 3) of the poses, after alignment."""
    truth, known = read_trajectory(path).at(found.stamps)
    poses, truth = found.poses[known], truth[known]
    return between(truth, compose(_alignment(poses, truth), poses))


def _alignment(poses: Array, truth: Array) -> Array:
    """Pose (3,) of the frame of `poses` in that of `truth`, by least squares of the places (Umeyama 1991)."""
    a, b = poses[:, :2], truth[:, :2]
    u, _, vt = np.linalg.svd((a - a.mean(axis=0)).T @ (b - b.mean(axis=0)))
    turn = vt.T @ np.diag([1.0, np.linalg.det(vt.T @ u.T)]) @ u.T
    angle = float(np.arctan2(turn[1, 0], turn[0, 0]))
    shift = b.mean(axis=0) - transform([0.0, 0.0, angle], a.mean(axis=0))
    return np.array([*shift, angle])


def _localize(case: Case, other: tuple[str, str], folder: Path, made: Path) -> dict[str, Any]:
    """Share of single scans of another run that are found first, on the made map and on the given one."""
    found = read_trajectory(made.with_suffix(".tum"))
    truth, known = read_trajectory(folder / case.truth).at(found.stamps)
    frame = _alignment(found.poses[known], truth[known])
    reference = read_trajectory(folder / other[1])
    own = Trajectory(reference.stamps, compose(inverse(frame), reference.poses))
    moved = made.with_suffix(".other.tum")
    _write(own, moved)
    return {
        "made": _single_scans(folder / other[0], made, moved),
        "given": _single_scans(folder / other[0], folder / "map.yaml", folder / other[1]),
    }


def _write(way: Trajectory, path: Path) -> None:
    lines = [
        f"{stamp // NS}.{stamp % NS:09d} {x} {y} 0 0 0 {np.sin(t / 2)} {np.cos(t / 2)}"
        for stamp, (x, y, t) in zip(way.stamps.tolist(), way.poses.tolist(), strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _single_scans(log: Path, grid: Path, reference: Path) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "figures.json"
        command: list[str | Path] = [EIGENSCAN, "evaluate", "--log", log, "--map", grid]
        command += ["--ground-truth", reference, "--json", out, "--skip", "exhaustive", "--skip", "memory"]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        figures = json.loads(out.read_text(encoding="utf-8"))
    return {
        "top1": figures["single_scan"]["top1"],
        "success_rate": figures["success_rate"],
        "median_m": figures["error"]["position_m"]["median"],
    }


def _line(row: dict[str, Any]) -> str:
    metres, degrees = row["metres"], row["degrees"]
    cells = [row["log"], "yes" if row["odometry"] else "no", row["judged_by"].rsplit(".")[-1], f"{row['n']}"]
    cells += [f"{100 * metres[name]:.1f}" for name in ("mean", "median", "max")]
    cells += [f"{degrees[name]:.2f}" for name in ("mean", "max")]
    cells += [f"{row['seconds']:.0f}", f"{row['recorded_seconds'] / row['seconds']:.0f}"]
    line = "| " + " | ".join(cells) + " |"
    for name, figures in row.get("localized", {}).items():
        line += (
            f"\n  another run on the {name} map: first of a single scan right {100 * figures['top1']:.0f} %, "
            f"windows {100 * figures['success_rate']:.0f} %, median {100 * (figures['median_m'] or 0):.1f} cm"
        )
    return line


if __name__ == "__main__":
    main()
