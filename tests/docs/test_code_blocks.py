"""The commands of the pages work: it is run, or where it needs a robot, at least read."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.code_blocks import Block, blocks, commands, pages, refusal
from tests.environment import ROOT

EVERY = [block for page in pages() for block in blocks(page)]
READ = [block for block in EVERY if block.language in ("", "sh") and any(commands(block.code))]
RUN = sorted({block.page for block in EVERY if block.runs})


def _name(block: Block) -> str:
    return f"{block.page}:{block.line}"


PRINTED = re.compile(r"^print\(.*\)\s+# (<.*?)\.\.\.$", re.MULTILINE)
"""What a page shows of an object that a program prints."""


def _run(command: list[str], page: str, folder: Path) -> str:
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "HOME": str(folder), "MPLBACKEND": "Agg"}
    done = subprocess.run(
        command,
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        timeout=800,
        check=False,
    )
    assert done.returncode == 0, f"{page}: {command[-1]}\n{done.stdout[-1000:]}\n{done.stderr[-2000:]}"
    return done.stdout


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bash of the test's own: the one that the tests are run from, if any, stays as it is."""
    monkeypatch.setattr("typer._completion_shared._get_shell_name", lambda: "bash")
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.mark.parametrize("block", READ, ids=_name)
def test_every_command_is_one_that_there_is(block: Block, shell: None) -> None:
    """Also those that are not run: no page names an option that is gone."""
    for words in commands(block.code):
        assert refusal(words) is None


@pytest.mark.slow
@pytest.mark.parametrize("page", RUN)
def test_what_a_page_states_works(page: str, tmp_path: Path) -> None:
    """Shell blocks one after the other in one empty folder, then all Python of the page as one program."""
    mine = [block for block in blocks(page) if block.runs]
    for block in mine:
        if block.language == "sh":
            _run(["bash", "-euo", "pipefail", "-c", block.code], page, tmp_path)
    if program := "\n".join(block.code for block in mine if block.language == "python"):
        printed = _run([sys.executable, "-W", "error::SyntaxWarning", "-c", program], page, tmp_path)
        for words in PRINTED.findall(program):
            assert words in printed, page


def test_the_pages_of_the_menu_are_looked_at() -> None:
    assert {"README.md", "docs/library.md", "docs/data.md", "docs/command.md"} <= set(pages())
    assert "docs/library.md" in RUN
    assert (ROOT / "mkdocs.yml").is_file()
