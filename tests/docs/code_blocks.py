"""The blocks of code in the project's pages, by a Markdown parser, and what may be typed in them."""

from __future__ import annotations

import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import typer
from eigenscan.cli.main import app
from eigenscan.runtime.settings import load
from eigenscan.workbench.settings_page import KINDS, settings_of
from markdown_it import MarkdownIt

from tests.environment import ROOT


@dataclass(frozen=True)
class Block:
    """A fenced block. One with a title, which readers see, needs what a test has not, and is only parsed."""

    page: str
    line: int
    language: str
    title: str
    code: str

    @property
    def runs(self) -> bool:
        """Whether a test runs it."""
        return self.language in ("sh", "python") and not self.title


def pages() -> list[str]:
    """All pages that people read."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.md"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return sorted(name for name in set(listed.split("\0")) if name and not name.startswith("."))


def blocks(page: str) -> list[Block]:
    """The fenced blocks of a page, in order."""
    found = []
    for token in MarkdownIt().parse((ROOT / page).read_text(encoding="utf-8")):
        if token.type == "fence":
            language, _, rest = token.info.strip().partition(" ")
            title = re.search(r'title="([^"]*)"', rest)
            line = token.map[0] + 1 if token.map else 0
            found.append(Block(page, line, language, title[1] if title else "", token.content))
    return found


def commands(code: str) -> Iterator[list[str]]:
    """The words of each of our commands in a block of shell, what it is piped into left out."""
    for line in code.replace("\\\n", " ").splitlines():
        if re.match(r"eigenscan(-[a-z-]+)? ", line):
            words = shlex.split(line, comments=True)
            ends = [words.index(word) for word in ("|", ">", "&", "&&", ";") if word in words]
            yield words[: min(ends, default=len(words))]


def refusal(words: list[str]) -> str | None:
    """Why a command would be refused when typed; None where it would be taken."""
    try:
        _read(words)
    except typer.Exit as ended:  # of --help
        return f"{' '.join(words)}: ends with {ended.exit_code}" if ended.exit_code else None
    except SystemExit as ended:  # of a service's
        return f"{' '.join(words)}: ends with {ended.code}" if ended.code else None
    except Exception as error:
        return f"{' '.join(words)}: {getattr(error, 'message', error)}"
    return None


def _read(words: list[str]) -> None:
    name = words[0].removeprefix("eigenscan-")
    if name in KINDS:
        load(settings_of(name), name, words[1:])
        return
    command: Any = typer.main.get_command(app)
    rest, parent = words[1:], None
    while True:
        parent = command.make_context(command.name, rest, parent=parent)
        if not hasattr(command, "resolve_command"):
            return
        _, command, rest = command.resolve_command(parent, [*parent._protected_args, *parent.args])
