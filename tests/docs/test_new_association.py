"""The page of a first change works as it is written: its module, its line in the table, its test."""

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from eigenscan.projector.association.kinds import MODULES, association

from tests.docs.code_blocks import blocks
from tests.services.projector.sheets import random_query, random_sheets

PAGE = "docs/new-association.md"
MODULE = "eigenscan.projector.association.plain"


def test_its_module_its_line_and_its_test_work_together(monkeypatch: pytest.MonkeyPatch) -> None:
    module, line, test = (block.code for block in blocks(PAGE) if block.language == "python")
    made = ModuleType(MODULE)
    monkeypatch.setitem(sys.modules, MODULE, made)
    exec(compile(module, "plain.py", "exec"), made.__dict__)
    monkeypatch.setattr("eigenscan.projector.association.kinds.MODULES", eval(f"{{{line}}}") | MODULES)
    rng = np.random.default_rng(3)
    sheets = [random_sheets(rng) for _ in range(2)]
    found = association("plain", sheets, 0.5)
    tree = association("tree", sheets, 0.5)
    query = random_query(rng, sheets)
    assert np.array_equal(found.nearest(*query, 9).rows, tree.nearest(*query, 9).rows)
    names: dict[str, Any] = {}
    exec(compile(test, "test_plain.py", "exec"), names)
    tests = [each for name, each in names.items() if name.startswith("test_")]
    assert tests
    for each in tests:
        each()
