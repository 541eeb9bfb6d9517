"""Standard output that ends early, is full or is closed: words that fit, and no trace."""

import shlex
import subprocess
from pathlib import Path

import pytest

from tests.environment import EIGENSCAN

COMMANDS = ["evaluate --help", "fleet certify --help", "simtest --seeds 0..0"]


def _run(typed: str, rest: str, folder: Path) -> subprocess.CompletedProcess[str]:
    line = f"{shlex.quote(str(EIGENSCAN))} {typed} {rest}"
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_reader_that_has_enough_is_no_fault(tmp_path: Path, typed: str) -> None:
    result = _run(typed, "| true; exit ${PIPESTATUS[0]}", tmp_path)
    assert (result.returncode, result.stderr) == (1, "")


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_full_standard_output_is_named(tmp_path: Path, typed: str) -> None:
    result = _run(typed, "> /dev/full", tmp_path)
    assert result.returncode == 2
    assert "standard output: No space left on device: make room, or name another place" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_full_standard_output_is_not_taken_for_what_is_written(tmp_path: Path) -> None:
    made = _run("simulate --seconds 1 -o drive.mcap", "", tmp_path)
    assert made.returncode == 0, made.stderr
    result = _run("import drive.mcap -o a.mcap", "> /dev/full", tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("eigenscan import: standard output: No space left")


@pytest.mark.parametrize("typed", COMMANDS)
def test_closed_outputs_are_no_failure(tmp_path: Path, typed: str) -> None:
    assert _run(typed, ">&- 2>&-", tmp_path).returncode == 0
