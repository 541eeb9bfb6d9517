"""The reliability diagram of the benchmark: several logs are one source, and an earlier run can be drawn."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from eigenscan.workbench.evaluation.metrics import calibration, pooled
from PIL import Image

from tests.environment import ROOT

BENCHMARKS = ROOT / "benchmarks"


def test_logs_pooled_by_their_bins_are_the_diagram_of_all_their_poses() -> None:
    rng = np.random.default_rng(8)
    published, right = rng.uniform(0, 1, 900) ** 0.3, rng.uniform(0, 1, 900) < 0.6
    published[:3] = 1.0
    parts = [slice(0, 100), slice(100, 850), slice(850, 900)]
    merged = pooled([calibration(published[part], right[part]) for part in parts])
    whole = calibration(published, right)
    assert [entry.count for entry in merged] == [entry.count for entry in whole]
    for name in ("confidence", "right"):
        np.testing.assert_allclose([vars(e)[name] for e in merged], [vars(e)[name] for e in whole])


def test_an_earlier_run_is_drawn_without_its_logs(tmp_path: Path) -> None:
    bins = [{"count": 10, "confidence": 0.55, "right": 0.4}, {"count": 90, "confidence": 0.99, "right": 1.0}]
    earlier, drawn = tmp_path / "run.json", tmp_path / "reliability.png"
    reported = {"the scans are late": {"runs": 2, "seconds": 31.4}}
    earlier.write_text(
        json.dumps({"intel": {"calibration": bins}, "none": {"calibration": [], "reported": reported}})
    )
    command: list[str | Path] = [
        sys.executable,
        BENCHMARKS / "evaluate.py",
        "--from",
        earlier,
        "--picture",
        drawn,
    ]
    shown = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    assert shown.endswith("none: health reported for 31 s: the scans are late\n")
    red, _, blue = np.moveaxis(np.asarray(Image.open(drawn).convert("RGB")).astype(int), -1, 0)
    assert (blue > red + 60).any()  # the first log's marks


def test_a_file_beside_a_log_that_is_none_is_named_and_left_out(tmp_path: Path) -> None:
    """A note on the mount, beside the log that it is of, ended the benchmark."""
    folder = tmp_path / "hall"
    folder.mkdir()
    for name in ("map.yaml", "drive.tum"):
        (folder / name).touch()
    (folder / "drive.clf").write_text("FLASER 1 2.0 0 0 0 0 0 0 0.0 robot 0.0\n")
    (folder / "drive.mount").write_text("0.1 0 0\n")
    listed = "import pathlib, evaluate; print([c.log for c in evaluate.buildings(pathlib.Path('.'))])"
    done = subprocess.run(
        [sys.executable, "-c", listed],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(BENCHMARKS)},
        check=True,
        capture_output=True,
        text=True,
    )
    assert done.stdout == "['drive.clf']\n"
    assert "drive.mount: is of no known format" in done.stderr
