"""Headings and positions beside relations that people checked by hand: is an error ours, or the reference's?

    .venv/bin/python benchmarks/relations.py [--datasets FOLDER] [--only intel] [--json OUT]

A relation (Kuemmerle et al. 2009) says how a robot moved from one scan to another. Where both are in the
windows and claimed rightly, it judges the claimed poses and the reference's alike. An error here is of two
poses: of one it is smaller by the root of two, where the two err independently.
"""

import argparse
import bz2
import csv
import gzip
import json
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import numpy as np
from eigenscan.geometry.pose import between
from eigenscan.workbench.evaluation.metrics import errors, right
from eigenscan.workbench.evaluation.reference import nanoseconds_of, read_trajectory

DATASETS = Path(__file__).parents[1].parent / "shared/datasets"
EIGENSCAN = Path(sys.executable).parent / "eigenscan"
LOCALIZED = 3
"""STATE_LOCALIZED of the contract."""


def new_stamps(folder: Path, name: str) -> dict[str, int]:
    """Stamps, ns, in log.clf.gz by those of the original log; the same ranges are the same scan."""
    scans, stamps = defaultdict[tuple[int, ...], list[int]](list), dict[str, int]()
    taken = defaultdict[tuple[int, ...], int](int)
    for line in gzip.decompress((folder / "log.clf.gz").read_bytes()).decode().splitlines():
        if line.startswith("ROBOTLASER1"):
            words = line.split()
            scans[ranges(words[9 : 9 + int(words[8])])].append(nanoseconds_of(words[-3]))
    for line in bz2.decompress((folder / f"{name}.clf.bz2").read_bytes()).decode().splitlines():
        if line.startswith("FLASER"):
            words = line.split()
            seen = ranges(words[2 : 2 + int(words[1])])
            # scans that are alike come in the same order
            if taken[seen] < len(scans[seen]):
                stamps.setdefault(words[-3], scans[seen][taken[seen]])
                taken[seen] += 1
    return stamps


def ranges(words: list[str]) -> tuple[int, ...]:
    """A scan's ranges, cm."""
    return tuple(round(float(word) * 100) for word in words)


def claimed(folder: Path) -> dict[int, np.ndarray]:
    """Poses that were claimed in the windows, by stamp, ns."""
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch) / "poses.csv"
        command: list[str | Path] = [EIGENSCAN, "evaluate", "--log", folder / "log.clf.gz", "--poses", out]
        command += ["--map", folder / "map.yaml", "--ground-truth", folder / "log.tum"]
        command += [
            "--windows",
            folder / "windows.csv",
            "--skip",
            "single-scans",
            "--skip",
            "memory",
            "--jobs",
            "2",
        ]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        with out.open(encoding="utf-8") as file:
            rows = [row for row in csv.DictReader(file) if int(row["state"]) == LOCALIZED]
    return {int(row["time_ns"]): np.array([float(row[axis]) for axis in ("x", "y", "theta")]) for row in rows}


def judge(folder: Path, name: str) -> dict[str, float]:
    """Median errors, m and degrees, of what was claimed and of the reference; and how many relations."""
    reference, poses, stamps = read_trajectory(folder / "log.tum"), claimed(folder), new_stamps(folder, name)
    ours, theirs, said = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for line in (folder / f"{name}.relations").read_text(encoding="utf-8").splitlines():
        words = line.split()
        pair = [stamps.get(word, 0) for word in words[:2]]
        truths, known = reference.at(pair)
        if len(words) != 8 or not known.all() or not all(stamp in poses for stamp in pair):
            continue
        found = np.array([poses[stamp] for stamp in pair])
        if right(*errors(found, truths)).all():
            ours.append(between(*found))
            theirs.append(between(*truths))
            said.append(np.array([float(words[index]) for index in (2, 3, 7)]))
    figures = {"relations": float(len(said))}
    for who, steps in (("claimed", ours), ("reference", theirs)):
        metres, radians = errors(np.array(steps).reshape(-1, 3), np.array(said).reshape(-1, 3))
        figures |= {f"{who}_m": float(np.median(metres)), f"{who}_deg": float(np.degrees(np.median(radians)))}
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument("--only", choices=("intel", "fr079"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = {}
    for name in [options.only] if options.only else ["intel", "fr079"]:
        row = found[name] = judge(options.datasets / name, name)
        print(
            f"{name}: {row['relations']:.0f} relations; median error of the claimed poses "
            f"{row['claimed_m'] * 100:.1f} cm {row['claimed_deg']:.2f} deg, "
            f"of the reference {row['reference_m'] * 100:.1f} cm {row['reference_deg']:.2f} deg",
            flush=True,
        )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
