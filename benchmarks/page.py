"""Writes docs/benchmarks.md of benchmarks/results, and the figures that other pages take from there.

    .venv/bin/python benchmarks/page.py            # write
    .venv/bin/python benchmarks/page.py --check    # exit code 1 where a page is not what this would write

In a page, `<!--= NAME PLACE FORM -->…<!--=-->` holds a figure: NAME of the benchmark, its place in the JSON,
and how it is written; `<!--= table NAME -->…<!--=-->` holds the table [NAME.short] of benchmarks.toml.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
SPEC = ROOT / "benchmarks/benchmarks.toml"
RESULTS = ROOT / "benchmarks/results"
PAGE = "docs/benchmarks.md"
PAGES = ("README.md", "docs/*.md", "services/*/README.md", "cli/README.md")
MARK = re.compile(r"<!--= (?P<what>.+?) -->(?P<now>.*?)<!--=-->", re.DOTALL)
HEAD = """# Benchmarks

```sh title="in a clone, with the logs beside it"
.venv/bin/python benchmarks/record.py replay raycasting    # runs these, keeps their figures, writes this page
.venv/bin/python benchmarks/record.py --all                # all: hours
```

This page is written by `benchmarks/page.py` from `benchmarks/results`, one JSON a benchmark; no figure is
typed by hand. **Bold** is a goal that is not reached. *Load* is the machine's load average before and after:
above the number of its cores other work ran beside the benchmark, and times are too high.
"""
SCALES = {"%": 100.0, "cm": 100.0}
"""What a figure is multiplied with to be in its unit, where that is not the JSON's own."""


class PageError(ValueError):
    """A page or benchmarks.toml asks for what there is not."""


def main() -> None:
    """Writes or checks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    wrong = []
    for page, text in pages():
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            wrong.append(str(page.relative_to(ROOT)))
            if not given.check:
                page.write_text(text, encoding="utf-8")
    if given.check and wrong:
        sys.exit(f"{', '.join(wrong)}: other figures than in benchmarks/results: run benchmarks/page.py")


def pages() -> Iterator[tuple[Path, str]]:
    """Each page that holds figures of benchmarks, and what its text must be."""
    spec = tomllib.loads(SPEC.read_text(encoding="utf-8"))
    kept = {name: json.loads((RESULTS / f"{name}.json").read_text()) for name in spec if _has(name)}
    yield ROOT / PAGE, benchmarks_page(spec, kept)
    for page in sorted({path for pattern in PAGES for path in ROOT.glob(pattern)}):
        text = page.read_text(encoding="utf-8")
        if page != ROOT / PAGE and MARK.search(text):
            yield page, MARK.sub(partial(_filled, page, spec, kept), text)


def benchmarks_page(spec: dict[str, Any], kept: dict[str, Any]) -> str:
    """docs/benchmarks.md."""
    sections = [_section(name, spec[name], kept[name]) for name in spec if name in kept]
    missed = [line for name in kept for line in _missed(spec[name], kept[name]["figures"])]
    without = [name for name in spec if name not in kept]
    parts = [HEAD, "## Goals that are not reached\n", "\n".join(missed or ["None."]) + "\n", *sections]
    if without:
        names = ", ".join(f"`{name}` ({spec[name]['title'].lower()})" for name in without)
        parts.append(
            f"## Without kept figures\n\n`benchmarks/record.py NAME` runs and keeps them: {names}.\n"
        )
    return "\n".join(parts)


def _section(name: str, spec: dict[str, Any], result: dict[str, Any]) -> str:
    about = ast.get_docstring(ast.parse((ROOT / f"benchmarks/{name}.py").read_text(encoding="utf-8"))) or ""
    load = " to ".join(f"{each:g}" for each in result["load"]) if result["load"] else "not known"
    facts = f"{result['date']}, commit `{result['commit']}`, load {load}; {result['machine']}"
    parts = [f"## {spec['title']}\n", f"{about.splitlines()[0]}\n", f"`{result['command']}`; {facts}.\n"]
    figures = result["figures"]
    if "columns" in spec:
        parts.append(_table(spec, figures) + "\n")
    if rows := list(_rows(spec, figures)):
        lines = ["| | | goal |", "|---|---|---|"]
        for what, value, form, goal in rows:
            lines.append(
                f"| {what} | {_bold(written(value, form), value, form, goal)} | {_told(goal, form)} |"
            )
        parts.append("\n".join(lines) + "\n")
    if "note" in spec:
        parts.append(spec["note"].strip() + "\n")
    return "\n".join(parts)


def _table(spec: dict[str, Any], figures: Any, short: dict[str, Any] | None = None) -> str:
    """A row for each entry of `figures` (or of its place `rows`), a column for each of the spec's columns.

    `short`: those columns and rows alone, and what the rows are called. `turned`: rows are columns, for what
    is wider than a page.
    """
    columns = [entry for entry in spec["columns"] if short is None or entry[0] in short["columns"]]
    entries = _entries(spec, figures)
    names = short["rows"] if short else {key: key for key, _ in entries if key}
    goals = [_told(goal, form) for _, _, form, goal in columns]
    rows = [["", *(entry[0] for entry in columns)]]
    rows += [["goal", *goals]] if any(goals) else []
    for key, entry in entries:
        if names and key not in names:
            continue
        values = [(place(entry, where), form, goal) for _, where, form, goal in columns]
        cells = [_bold(written(value, form), value, form, goal) for value, form, goal in values]
        rows.append([names[key] if names else "", *cells])
    if spec.get("turned"):
        rows = [list(column) for column in zip(*rows, strict=True)]
        # the goals stand at the end, after the figures
        rows = [[row[0], *row[2:], row[1]] for row in rows] if any(goals) else rows
    elif not any(row[0] for row in rows):
        rows = [row[1:] for row in rows]
    rows.insert(1, ["---"] * len(rows[0]))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _rows(spec: dict[str, Any], figures: Any) -> Iterator[tuple[str, Any, str, str]]:
    """What a figure is, its value, form and goal; `*` in a place gives a row for each entry there."""
    for what, where, form, goal in spec.get("figures", []):
        before, star, after = where.partition("*/")
        if not star:
            yield what, place(figures, where), form, goal
            continue
        for key, entry in place(figures, before.rstrip("/")).items():
            if (value := place(entry, after)) is not None:
                yield what.replace("*", str(key)), value, form, goal


def _missed(spec: dict[str, Any], figures: Any) -> Iterator[str]:
    title = f"[{spec['title']}](#{_anchor(spec['title'])})"
    for what, value, form, goal in _rows(spec, figures):
        if not reached(value, form, goal):
            yield f"- {title}: {what}: {written(value, form)}; goal {_told(goal, form)}"
    for what, where, form, goal in spec.get("columns", []):
        values = [(key, place(entry, where)) for key, entry in _entries(spec, figures)]
        wrong = [f"{key} {written(value, form)}" for key, value in values if not reached(value, form, goal)]
        if wrong:
            yield f"- {title}: {what}: {', '.join(wrong)}; goal {_told(goal, form)}"


def _entries(spec: dict[str, Any], figures: Any) -> list[tuple[str, Any]]:
    """The rows of a table by name; those of a list have none."""
    found = place(figures, spec["rows"]) if "rows" in spec else figures
    return list(found.items()) if isinstance(found, dict) else [("", entry) for entry in found]


def _filled(page: Path, spec: dict[str, Any], kept: dict[str, Any], mark: re.Match[str]) -> str:
    """A mark with its figure, or with what is there where the benchmark has no kept figures."""
    words = mark["what"].split()
    name = words[1] if words[0] == "table" else words[0]
    if name not in spec:
        raise PageError(f"{page}: {mark['what']}: benchmarks.toml has no {name}")
    if name not in kept:
        return mark[0]
    figures = kept[name]["figures"]
    if words[0] == "table":
        text = f"\n\n{_table(spec[name], figures, spec[name]['short'])}\n\n"
    else:
        form = words[-1]
        value = place(figures, " ".join(words[1:-1]))
        if value is None:
            raise PageError(f"{page}: {mark['what']}: no such figure in benchmarks/results/{name}.json")
        text = written(value, form)
    return f"<!--= {mark['what']} -->{text}<!--=-->"


def place(figures: Any, where: str) -> Any:
    """The value at a place such as `all/to_localize/-1`; None where there is none."""
    value = figures
    for step in filter(None, where.split("/")):
        if isinstance(value, dict):
            value = value.get(step)
        elif isinstance(value, list) and step.lstrip("-").isdigit() and -len(value) <= int(step) < len(value):
            value = value[int(step)]
        else:
            return None
    return value


def written(value: Any, form: str) -> str:
    """A figure in its unit. `form`: a unit, with digits after the point behind a dot, such as `%.1`."""
    if value is None:
        return "\N{EN DASH}"
    if not isinstance(value, int | float) or isinstance(value, bool):
        return str(value)
    unit, digits = _unit(form)
    number = value * SCALES.get(unit, 1.0)
    if digits is None:
        digits = (
            0 if unit == "%" or abs(number) >= 100 or number == int(number) else 1 if abs(number) >= 1 else 2
        )
    text = f"{number:,.{digits}f}"
    return text + _spaced(unit)


def _spaced(unit: str) -> str:
    return unit if unit in ("°", "") else f" {unit}"


def _unit(form: str) -> tuple[str, int | None]:
    unit, _, digits = form.partition(".")
    return unit.replace("_", " "), int(digits) if digits else None


def reached(value: Any, form: str, goal: str) -> bool:
    """Whether a goal, in the unit shown, is reached; what has none is."""
    if not goal or value is None:
        return True
    relation, number = goal.split()
    shown, wanted = value * SCALES.get(_unit(form)[0], 1.0), float(number)
    return bool({"<=": shown <= wanted, ">=": shown >= wanted, "==": shown == wanted}[relation])


def _bold(text: str, value: Any, form: str, goal: str) -> str:
    return text if reached(value, form, goal) else f"**{text}**"


def _told(goal: str, form: str) -> str:
    if not goal:
        return ""
    relation, number = goal.split()
    sign = {"<=": "≤ ", ">=": "≥ ", "==": ""}[relation]
    return f"{sign}{number}{_spaced(_unit(form)[0])}"


def _anchor(title: str) -> str:
    """As the site and GitHub make it."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")


def _has(name: str) -> bool:
    return (RESULTS / f"{name}.json").exists()


if __name__ == "__main__":
    main()
