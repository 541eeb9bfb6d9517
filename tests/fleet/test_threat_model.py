"""The threat model: each line names a test that there is."""

import re

import pytest

from tests.environment import ROOT

TESTS = ROOT / "tests"
PAGE = ROOT / "docs/security.md"
ROWS = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| ")][1:]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.split("|")[1].strip()[:40])
def test_each_threat_names_tests_that_there_are(row: str) -> None:
    _, _, _, named, _ = row.split("|")
    file, tests = "", re.findall(r"`([^`]+)`", named)
    assert tests
    for one in tests:
        path, _, name = one.rpartition("::")
        file = path or file
        assert f"\ndef {name}(" in (TESTS / file).read_text(encoding="utf-8"), one


def test_the_page_has_threats() -> None:
    assert len(ROWS) >= 15
