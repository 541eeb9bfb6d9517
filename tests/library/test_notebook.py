"""The notebook does what it states, cell by cell, and is kept without outputs."""

import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from eigenscan.localize import Estimate, Hypotheses

from tests.environment import ROOT

NOTEBOOK = ROOT / "examples/notebook/localize.ipynb"


def _cells() -> list[dict[str, Any]]:
    return [cell for cell in json.loads(NOTEBOOK.read_text())["cells"] if cell["cell_type"] == "code"]


def test_it_finds_what_it_looks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(NOTEBOOK.parent)
    mpl.use("Agg")
    names: dict[str, Any] = {}
    for number, cell in enumerate(_cells()):
        exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}, code cell {number}", "exec"), names)
    found, estimate = names["found"], names["estimate"]
    assert isinstance(found, Hypotheses)
    assert np.allclose(found.poses[0], names["here"], atol=0.05)
    assert isinstance(estimate, Estimate)
    assert estimate.state == "localized"
    assert np.allclose(estimate.pose, names["true"], atol=0.05)


def test_its_outputs_are_stripped() -> None:
    assert [cell["outputs"] for cell in _cells()] == [[]] * len(_cells())
    assert {cell["execution_count"] for cell in _cells()} == {None}


def test_the_page_of_the_library_shows_the_way_to_it() -> None:
    assert str(NOTEBOOK.relative_to(ROOT)) in Path(ROOT / "docs/library.md").read_text()
