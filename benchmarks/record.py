"""Runs benchmarks, keeps their figures in benchmarks/results, and writes these into pages.

    .venv/bin/python benchmarks/record.py replay restart     # these; then the pages are written again
    .venv/bin/python benchmarks/record.py                    # the pages alone
    .venv/bin/python benchmarks/record.py --check            # exit code 1 where a page states another figure
    .venv/bin/python benchmarks/record.py evaluate --from OUT --commit 1e2d309   # a run made apart

benchmarks.toml has what docs/benchmarks.md shows of each. In other pages a mark `<!--= NAME PLACE UNIT -->`
to `<!--=-->` holds a figure, `<!--= table NAME -->` the table [NAME.short], and `<!--= leaderboard LOG -->`
that of benchmarks/leaderboard.py. Long lists, and rows a window
or scan (`per_...`), are not kept.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
HERE = ROOT / "benchmarks"
PAGE = ROOT / "docs/benchmarks.md"
PAGES = ("README.md", "docs/*.md", "services/*/README.md", "cli/README.md")
MARK = re.compile(r"<!--= (?P<what>.+?) -->.*?<!--=-->", re.DOTALL)
LONGEST_LIST = 40
HEAD = """# Benchmarks

```sh title="in a clone, with the logs beside it"
.venv/bin/python benchmarks/record.py replay restart    # runs these, keeps their figures, writes this page
```

`benchmarks/record.py` writes this page from `benchmarks/results`. **Bold** misses a goal. *Load* is the load
average before and after: above the number of cores, times are too high. Finished studies:
[reports](reports.md).
"""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="BENCHMARK")
    parser.add_argument("--check", action="store_true", help="write nothing; tell pages with other figures")
    parser.add_argument("--from", dest="earlier", type=Path, help="JSON of a run made apart; one BENCHMARK")
    parser.add_argument("--commit", help="with --from: what was measured")
    given = parser.parse_args()
    if given.earlier and (len(given.names) != 1 or not given.commit):
        parser.error("--from: name one benchmark and --commit")
    for name in given.names:
        if not (HERE / f"{name}.py").exists():
            parser.error(f"no benchmark {name} in {HERE}")
    failed = [name for name in given.names if not _keep(name, given.earlier, given.commit)]
    wrong = [(page, text) for page, text in pages() if page.read_text(encoding="utf-8") != text]
    if given.check and wrong:
        reported = ", ".join(str(page.relative_to(ROOT)) for page, _ in wrong)
        sys.exit(f"{reported}: other figures than in benchmarks/results: run benchmarks/record.py")
    for page, text in wrong:
        page.write_text(text, encoding="utf-8")
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; what was kept of them before stays")


def _keep(name: str, earlier: Path | None, commit: str | None) -> bool:
    """Runs a benchmark, or takes a run made apart; whether there are figures."""
    began, load = time.time(), [os.getloadavg()[0]]
    command = [f"benchmarks/{name}.py", *_spec().get(name, {}).get("arguments", [])]
    with tempfile.TemporaryDirectory() as folder:
        out = earlier or Path(folder) / "figures.json"
        if earlier is None:
            print(f"$ {' '.join(command)}", flush=True)
            done = subprocess.run([sys.executable, *command, "--json", out], cwd=ROOT, check=False)
            if done.returncode != 0 or not out.exists():
                return False
        figures, load = json.loads(out.read_text(encoding="utf-8")), [*load, os.getloadavg()[0]]
        date = datetime.fromtimestamp(out.stat().st_mtime, UTC).strftime("%Y-%m-%d")
    kept = {
        "command": " ".join([".venv/bin/python", *command]),
        "machine": machine(),
        "commit": commit or _commit(),
        "date": date,
        "load": None if earlier else [round(each, 1) for each in load],
        "took_s": None if earlier else round(time.time() - began),
        "figures": short(figures),
    }
    text = json.dumps(kept, indent=1, ensure_ascii=False) + "\n"
    (HERE / f"results/{name}.json").write_text(text, encoding="utf-8")
    return True


LEFT_OUT = object()


def short(figures: Any) -> Any:
    """Figures to four digits, without long lists and without this machine's paths."""
    if isinstance(figures, dict):
        kept = {str(key): short(value) for key, value in figures.items() if not str(key).startswith("per_")}
        return {key: value for key, value in kept.items() if value is not LEFT_OUT}
    if isinstance(figures, list):
        return (
            LEFT_OUT if len(figures) > LONGEST_LIST else [e for e in map(short, figures) if e is not LEFT_OUT]
        )
    if isinstance(figures, float):
        return float(f"{figures:.4g}")
    return LEFT_OUT if isinstance(figures, str) and figures.startswith("/") else figures


def machine() -> str:
    """Processor, cores, memory, system and Python."""
    info = Path("/proc/cpuinfo")
    named = re.search(r"model name\s*: (.*)", info.read_text(encoding="utf-8")) if info.exists() else None
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return (
        f"{named[1] if named else platform.machine()}, {os.cpu_count()} cores, {memory:.0f} GB, "
        f"{platform.system()}, Python {platform.python_version()}"
    )


def _commit() -> str:
    """What is measured; pages and kept figures may have changed since."""
    changed = _output("git", "status", "--porcelain", "--", ".", ":!benchmarks/results", ":!*.md")
    return _output("git", "rev-parse", "--short=9", "HEAD") + ("-dirty" if changed else "")


def _output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def _spec() -> dict[str, Any]:
    return tomllib.loads((HERE / "benchmarks.toml").read_text(encoding="utf-8"))


def pages() -> Iterator[tuple[Path, str]]:
    """Each page that holds figures of benchmarks, and what its text must be."""
    spec = _spec()
    kept = {file.stem: json.loads(file.read_text()) for file in (HERE / "results").glob("*.json")}
    shown = [name for name in spec if name in kept and "columns" in spec[name] and "page" not in spec[name]]
    missed = [line for name in shown for line in _missed(spec[name], kept[name]["figures"])]
    parts = [HEAD, "## Goals that are not reached\n", "\n".join(missed or ["None."]) + "\n"]
    yield PAGE, "\n".join([*parts, *(_section(spec[name], kept[name]) for name in shown)])
    for page in sorted({path for pattern in PAGES for path in ROOT.glob(pattern)} - {PAGE}):
        text = page.read_text(encoding="utf-8")
        if MARK.search(text):
            yield page, MARK.sub(partial(_filled, page, spec, kept), text)


def _section(spec: dict[str, Any], result: dict[str, Any]) -> str:
    load = " to ".join(f"{each:g}" for each in result["load"]) if result["load"] else "not known"
    processor, cores = result["machine"].split(", ")[:2]
    facts = f"{result['date']}, commit `{result['commit']}`, load {load}; {processor}, {cores}"
    parts = [f"## {spec['title']}\n", f"`{result['command']}`; {facts}.\n"]
    parts += [_table(spec, result["figures"]) + "\n", spec["note"] + "\n" if "note" in spec else ""]
    return "\n".join(filter(None, parts))


def _entries(spec: dict[str, Any], figures: Any) -> dict[str, Any]:
    """What a table compares, by name: the entries of the figures or of a place in them, or all as one."""
    found = {"": figures} if spec.get("one_row") else place(figures, spec.get("rows", ""))
    return found if isinstance(found, dict) else {" " * number: entry for number, entry in enumerate(found)}


def _table(spec: dict[str, Any], figures: Any, part: dict[str, Any] | None = None) -> str:
    """Entries beside each other, or one below the other where they are many; `part`: some of the figures."""
    entries, columns = _entries(spec, figures), spec["columns"]
    if part:
        entries = {part["rows"][key]: entry for key, entry in entries.items() if key in part["rows"]}
        columns = [column for column in columns if column[0] in part["columns"]]
    goals = any(column[3] for column in columns)
    head = ["", *(key.strip() for key in entries), *(["goal"] if goals else [])]
    lines = [head]
    for what, where, unit, goal in columns:
        values = [place(entry, where) for entry in entries.values()]
        if all(value is None for value in values):
            continue  # what was not measured
        cells = [written(v, unit) if reached(v, unit, goal) else f"**{written(v, unit)}**" for v in values]
        lines.append([what, *cells, *([_goal(goal, unit)] if goals else [])])
    if len(entries) > len(columns):
        lines = [list(line) for line in zip(*lines, strict=True)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _missed(spec: dict[str, Any], figures: Any) -> Iterator[str]:
    anchor = re.sub(r"[^\w\- ]", "", spec["title"].lower()).replace(" ", "-")
    for what, where, unit, goal in spec["columns"]:
        values = [(key.strip(), place(entry, where)) for key, entry in _entries(spec, figures).items()]
        wrong = [f"{key} {written(v, unit)}".strip() for key, v in values if not reached(v, unit, goal)]
        if wrong:
            reported = f"{', '.join(wrong)}. Goal: {_goal(goal, unit)}."
            yield f"- [{spec['title']}](#{anchor}). {what[0].upper()}{what[1:]}: {reported}"


def _filled(page: Path, spec: dict[str, Any], kept: dict[str, Any], mark: re.Match[str]) -> str:
    """A mark with its figure or table."""
    kind, *rest = mark["what"].split()
    if kind == "leaderboard":
        from leaderboard import table  # which imports this module

        return f"<!--= {mark['what']} -->\n\n{table(rest[0])}\n\n<!--=-->"
    name = rest[0] if kind == "table" else kind
    if name not in kept:
        sys.exit(f"{page}: {mark['what']}: there is no benchmarks/results/{name}.json")
    figures = kept[name]["figures"]
    if kind == "table":
        text = f"\n\n{_table(spec[name], figures, spec[name]['short'])}\n\n"
    elif (value := place(figures, " ".join(rest[:-1]))) is not None:
        text = written(value, rest[-1])
    else:
        sys.exit(f"{page}: {mark['what']}: no such figure in benchmarks/results/{name}.json")
    return f"<!--= {mark['what']} -->{text}<!--=-->"


def place(figures: Any, where: str) -> Any:
    """The value at a place such as `all/to_localize/-1`; None where there is none."""
    value = figures
    for step in filter(None, where.split("/")):
        try:
            value = value[int(step)] if isinstance(value, list) else value[step]
        except (LookupError, TypeError, ValueError):
            return None
    return value


def written(value: Any, unit: str) -> str:
    """A figure in its unit, which may end in how many digits follow the point: `%.1`."""
    if value is None or isinstance(value, str):
        return value or "\N{EN DASH}"
    unit, _, digits = unit.partition(".")
    number = _scaled(value, unit)
    whole = unit == "%" or abs(number) >= 100 or number == int(number)
    places = int(digits) if digits else 0 if whole else 1 if abs(number) >= 1 else 2
    return f"{number:,.{places}f}" + _spaced(unit)


def _scaled(value: float, unit: str) -> float:
    return value * (100.0 if unit.partition(".")[0] in ("%", "cm") else 1.0)


def _spaced(unit: str) -> str:
    return unit if unit in ("°", "") else f" {unit.replace('_', ' ')}"


def reached(value: Any, unit: str, goal: str) -> bool:
    """Whether a goal, in the unit shown, is reached; what has none is."""
    if not goal or value is None:
        return True
    shown, (relation, number) = _scaled(value, unit), goal.split()
    return {"<=": shown <= float(number), ">=": shown >= float(number), "==": shown == float(number)}[
        relation
    ]


def _goal(goal: str, unit: str) -> str:
    relation, _, number = goal.partition(" ")
    sign = {"<=": "≤ ", ">=": "≥ "}.get(relation, "")
    return f"{sign}{number}{_spaced(unit.partition('.')[0])}" if goal else ""


if __name__ == "__main__":
    main()
