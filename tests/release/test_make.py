"""`make demo` in a script ends by itself: nobody there could end the viewer."""

import os
import pty
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.environment import ROOT


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A Makefile over programs that only print how they are called."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    for program, does in (("tools/setup", "true"), (".venv/bin/eigenscan", 'echo "<$*>"')):
        path = tmp_path / program
        path.parent.mkdir(parents=True)
        path.write_text(f"#!/bin/sh\n{does}\n")
        path.chmod(0o755)
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "on_terminal", "called"),
    [
        ([], False, "<demo --headless>"),
        ([], True, "<demo>"),
        (["HEADLESS=1"], True, "<demo --headless>"),
        (["HEADLESS=1"], False, "<demo --headless>"),
    ],
)
def test_the_demo_has_a_viewer_on_a_terminal_only(
    clone: Path, arguments: list[str], on_terminal: bool, called: str
) -> None:
    ours, theirs = pty.openpty() if on_terminal else os.pipe()
    own = {name: value for name, value in os.environ.items() if "MAKE" not in name and name != "HEADLESS"}
    subprocess.run(["make", "demo", *arguments], cwd=clone, stdout=theirs, env=own, check=True)
    printed = os.read(ours, 1000)
    os.close(ours)
    os.close(theirs)
    assert printed.decode().strip() == called
