"""Counts the words of all pages, and checks them, help texts, settings and messages for plain English.

    .venv/bin/python tools/prose.py            # words and lines of each page, and of all
    .venv/bin/python tools/prose.py --check    # exit code 1: a sentence is too long, or a word not ours

The words are in tools/words.toml. Vale does the same, but its package fetches a program at its first run;
proselint takes no list of one's own.
"""

from __future__ import annotations

import argparse
import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import typer
from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).parents[1]
LONGEST = 30
"""Words of a sentence; the aim is 20."""

MOST_WORDS = 20_200
"""Words of all pages together, but for those that are made of the code."""
MADE = ("docs/settings.md",)

CODE = ("schemas", "geometry", "eigenspace", "runtime", "services", "library", "workbench", "fleet", "cli")
BESIDE = ("tests", "benchmarks", "examples", "tools")
END = re.compile(r"(?<=[.!?])[\"')*]*\s+(?=[\"'(*]*[A-Z0-9])")
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


class Text(NamedTuple):
    """A paragraph, a cell or a help text, and where it stands."""

    where: str
    text: str


def pages() -> list[str]:
    """All pages, from the repository's root."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "*.md"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    names = sorted(name for name in set(listed.split("\0")) if name)
    return [name for name in names if (ROOT / name).is_file()]


def words(page: str) -> int:
    """Words of a page, with its code and tables: parts between white space with a letter or a digit."""
    return sum(bool(re.search(r"\w", word)) for word in COMMENT.sub("", page).split())


def of_page(name: str, page: str) -> Iterator[Text]:
    """The paragraphs, list items and cells of a page; code counts as one word."""
    for token in MarkdownIt("commonmark").enable("table").parse(page):
        if token.type == "inline":
            line = token.map[0] + 1 if token.map else 0
            yield Text(f"{name}:{line}", "".join(map(_plain, token.children or [])))


def _plain(token: Token) -> str:
    if token.type == "code_inline":
        return "CODE" if re.search(r"\w", token.content) else ""
    return {"softbreak": " ", "hardbreak": ". "}.get(
        token.type, token.content if token.type == "text" else ""
    )


def of_commands() -> Iterator[Text]:
    """Help texts of all commands and options."""
    from eigenscan.cli.main import app

    yield from _of_command("eigenscan", typer.main.get_command(app))


def _of_command(name: str, command: Any) -> Iterator[Text]:
    for part in re.split(r"\n\s*\n|\x0c|\x08", command.help or ""):
        if not re.match(r"\s*Examples?:", part):
            yield Text(f"{name} --help", re.sub(r"--[a-z-]+", "CODE", " ".join(part.split())))
    for option in command.params:
        yield Text(f"{name} {(option.opts or [option.name])[0]}", getattr(option, "help", None) or "")
    if hasattr(command, "list_commands"):
        context = command.make_context(name, [], resilient_parsing=True)
        for each in command.list_commands(context):
            yield from _of_command(f"{name} {each}", command.get_command(context, each))


def of_settings() -> Iterator[Text]:
    """Descriptions of all settings."""
    from eigenscan.workbench.settings_page import KINDS, settings_of

    for service in KINDS:
        for name, field in settings_of(service).model_fields.items():
            yield Text(f"setting {service} {name}", field.description or "")


def names_in_code() -> Iterator[Text]:
    """Each name that a module, a test or a tool defines, its words apart."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    modules = [file for room in CODE for file in (ROOT / room).glob("**/src/**/*.py")]
    beside = [file for room in BESIDE for file in (ROOT / room).glob("**/*.py")]
    for file in sorted(modules + beside):
        if not file.stem.endswith("_pb2") and ".venv" not in file.parts:
            where = str(file.relative_to(ROOT))
            yield Text(where, _apart(file.stem))
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, kinds):
                    yield Text(f"{where}:{node.lineno}", _apart(node.name))
                elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                    yield Text(f"{where}:{node.lineno}", _apart(node.id))
                elif isinstance(node, ast.arg):
                    yield Text(f"{where}:{node.lineno}", _apart(node.arg))


def strings_in_code() -> Iterator[Text]:
    """Each text of a module that a user may read: errors, logs, health. No docstrings."""
    for file in sorted(file for room in CODE for file in (ROOT / room).glob("**/src/**/*.py")):
        if not file.stem.endswith("_pb2"):
            tree = ast.parse(file.read_text(encoding="utf-8"))
            documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
            for node in ast.walk(tree):
                if (
                    isinstance(node, ast.Constant)
                    and isinstance(node.value, str)
                    and " " in node.value.strip()
                ) and id(node) not in documents:
                    text = re.sub(r"--[a-z-]+", "CODE", node.value)
                    yield Text(f"{file.relative_to(ROOT)}:{node.lineno}", text)


def _apart(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).replace("_", " ")


def long_sentences(text: Text) -> Iterator[str]:
    """What is wrong with sentences of `text`."""
    for sentence in END.split(text.text):
        count = words(sentence)
        if count > LONGEST:
            yield f"{text.where}: {count} words in a sentence, {LONGEST} at most: {sentence[:60]}..."


def foreign_words(text: Text, banned: dict[str, str]) -> Iterator[str]:
    """What words of `text` are not ours."""
    for pattern, instead in banned.items():
        if found := re.search(rf"\b(?:{pattern})(?!\w)", text.text, re.IGNORECASE):
            yield f'{text.where}: "{found[0]}": write {instead}'


def faults() -> Iterator[str]:
    """All that is wrong."""
    banned = tomllib.loads((ROOT / "tools/words.toml").read_text(encoding="utf-8"))
    read = {name: (ROOT / name).read_text(encoding="utf-8") for name in pages()}
    texts = [text for name, page in read.items() for text in of_page(name, page)]
    for text in [*texts, *of_commands(), *of_settings()]:
        yield from long_sentences(text)
        yield from foreign_words(text, banned["text"])
    for text in strings_in_code():
        yield from foreign_words(text, banned["text"])
    for text in names_in_code():
        yield from foreign_words(text, banned["code"])
    if (whole := sum(words(page) for name, page in read.items() if name not in MADE)) > MOST_WORDS:
        yield f"all pages but settings.md: {whole} words, {MOST_WORDS} at most: shorten one"


def main() -> None:
    """Counts, or with --check finds faults."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true", help="exit code 1 where something is wrong")
    if parser.parse_args().check:
        found = list(faults())
        print(*found, sep="\n", file=sys.stderr)
        sys.exit(1 if found else 0)
    counts = [
        (words(text), text.count("\n"), name) for name in pages() for text in [(ROOT / name).read_text()]
    ]
    for count, lines, name in sorted(counts):
        print(f"{count:6} words {lines:5} lines  {name}")
    print(f"{sum(c[0] for c in counts):6} words {sum(c[1] for c in counts):5} lines  all {len(counts)} pages")


if __name__ == "__main__":
    main()
