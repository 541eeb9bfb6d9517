"""Figures stand in pages as benchmarks printed them: a page with other figures is reported, and put right."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.environment import ROOT


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The pages with their figures, to change."""
    for name in ("benchmarks", "docs"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("images", "__pycache__"))
    shutil.copy(ROOT / "README.md", tmp_path)
    return tmp_path


def _page(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(root / "benchmarks/record.py"), *options]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def _change(root: Path, name: str, place: list[str], value: float) -> None:
    file = root / f"benchmarks/results/{name}.json"
    result = json.loads(file.read_text())
    entry = result["figures"]
    for step in place[:-1]:
        entry = entry[step]
    entry[place[-1]] = value
    file.write_text(json.dumps(result))


def test_the_pages_are_as_the_figures_are() -> None:
    checked = _page(ROOT, "--check")
    assert checked.returncode == 0, checked.stderr


def test_another_figure_is_reported_and_written(copy: Path) -> None:
    _change(copy, "replay", ["times_real_time_median"], 1234.0)
    checked = _page(copy, "--check")
    assert checked.returncode == 1
    assert "docs/benchmarks.md" in checked.stderr
    assert _page(copy).returncode == 0
    text = (copy / "docs/benchmarks.md").read_text()
    assert "| faster than real time, median | 1,234 times | ≥ 50 times |" in text
    assert _page(copy, "--check").returncode == 0


def test_a_goal_that_is_missed_stands_on_top_and_bold(copy: Path) -> None:
    _change(copy, "restart", ["tracker", "answer_s"], 9.0)
    _page(copy)
    text = (copy / "docs/benchmarks.md").read_text()
    missed, _, rest = text.partition("\n## Goals")[2].partition("\n## ")
    assert "tracker 9.0 s" in missed
    assert "**9.0 s**" in rest
    _change(copy, "restart", ["tracker", "answer_s"], 1.0)
    _page(copy)
    assert (
        "tracker"
        not in (copy / "docs/benchmarks.md")
        .read_text()
        .partition("\n## Goals")[2]
        .partition("Working again")[2]
        .partition("\n")[0]
    )


def test_a_figure_in_a_sentence_follows(copy: Path) -> None:
    page = copy / "docs/own.md"
    page.write_text("It takes <!--= restart tracker/answer_s s.1 -->ages<!--=-->, they say.")
    _change(copy, "restart", ["tracker", "answer_s"], 1.26)
    assert _page(copy).returncode == 0
    assert page.read_text() == "It takes <!--= restart tracker/answer_s s.1 -->1.3 s<!--=-->, they say."


@pytest.mark.parametrize("what", ["nothing tracker/answer_s s", "restart tracker/nothing s"])
def test_a_figure_that_there_is_not_is_named(copy: Path, what: str) -> None:
    (copy / "docs/own.md").write_text(f"<!--= {what} -->1<!--=-->")
    refused = _page(copy)
    assert refused.returncode != 0
    assert "own.md" in refused.stderr
    assert what in refused.stderr
