"""Compiled code that is kept on disk, where several trackers start for the first time at once."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

USE = """
import numpy as np
from numba import njit
for _ in range({before}):  # numba numbers functions as they come: so two programs differ
    njit(lambda x: x)(1.0)
from eigenscan.geometry.symmetric import inverse_each
from eigenscan.tracker.covariance import determinant, mahalanobis_squared, residual
from eigenscan.tracker.association import within_gate
from eigenscan.tracker.continuity import going_on
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.prediction import predict
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.symmetric import fuse_each
x, C = np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1))
assert np.allclose(determinant(2 * C), 8) and np.allclose(inverse_each(2 * C), C / 2)
assert np.allclose(mahalanobis_squared(x + 1, C), 3) and np.allclose(residual(x + 1, x), 1)
assert np.allclose(fuse_each(x, C, x, C)[1], C / 2)
assert len(within_gate(x, C, x, C, 9.0)[0]) == 4 and going_on(x, x, 0.1, 0.1) == 2
moved = Motion((1.0, 0.0, 0.0), way=1.0, turn=0.0, slip=0.0, unknown=0.0, breaks=0.0, seconds=1.0)
assert np.allclose(predict(x, C, moved, TrackerSettings())[0], [1, 0, 0])
"""


def begin(cache: Path, before: int) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", USE.format(before=before)],
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)}, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_files_of_two_that_compiled_at_once_fit_each_other(tmp_path: Path) -> None:
    one, other, mixed = (tmp_path / name for name in ("one", "other", "mixed"))
    running = [begin(one, 0), begin(other, 5)]
    for process in running:
        _, output = process.communicate(timeout=600)
        assert process.returncode == 0, output
    files = sorted(path.relative_to(one) for path in one.rglob("*.nb?"))
    assert files == sorted(path.relative_to(other) for path in other.rglob("*.nb?"))
    assert len(files) > 10
    for bit in range(len(files).bit_length()):  # any two files come from different ones once
        for number, file in enumerate(files):
            (mixed / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2((one, other)[number >> bit & 1] / file, mixed / file)
        last = begin(mixed, 0)
        _, output = last.communicate(timeout=600)
        assert last.returncode == 0, output
