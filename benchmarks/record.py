"""Runs benchmarks and keeps their figures in benchmarks/results, with machine, load, commit and date.

    .venv/bin/python benchmarks/record.py replay raycasting     # these; then the pages are written anew
    .venv/bin/python benchmarks/record.py --all                 # all of benchmarks.toml: hours
    .venv/bin/python benchmarks/record.py evaluate --from OUT --commit 1e2d309   # a run made apart

Arguments of each are in benchmarks.toml. Long lists and rows a window or scan (`per_...`) are not kept.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RESULTS = HERE / "results"
LONGEST_LIST = 40


def main() -> None:
    """Runs, keeps, writes the pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="BENCHMARK")
    parser.add_argument("--all", action="store_true", help="every benchmark of benchmarks.toml")
    parser.add_argument("--from", dest="earlier", type=Path, help="JSON of a run made apart; one BENCHMARK")
    parser.add_argument("--commit", help="with --from: what was measured")
    parser.add_argument("--load", type=float, nargs=2, help="with --from: least and greatest, where known")
    given = parser.parse_args()
    known = tomllib.loads((HERE / "benchmarks.toml").read_text(encoding="utf-8"))
    names = list(known) if given.all else given.names
    if unknown := sorted(set(names) - set(known)):
        parser.error(f"no benchmark {unknown[0]}: benchmarks.toml has {', '.join(known)}")
    if not names or (given.earlier and (len(names) != 1 or not given.commit)):
        parser.error("name one benchmark and --commit" if given.earlier else "name benchmarks, or give --all")
    failed = []
    for name in names:
        arguments = known[name].get("arguments", [])
        if given.earlier:
            _keep_earlier(name, arguments, given.earlier, given.commit, given.load)
        elif not _keep(name, arguments):
            failed.append(name)
    subprocess.run([sys.executable, HERE / "page.py"], check=True)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}; what was kept of them before stays")


def _keep(name: str, arguments: list[str]) -> bool:
    """Runs a benchmark and writes results/NAME.json; whether there are figures."""
    began, load = time.time(), [os.getloadavg()[0]]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "figures.json"
        command = [f"benchmarks/{name}.py", *arguments]
        print(f"$ {' '.join(command)}", flush=True)
        done = subprocess.run([sys.executable, *command, "--json", out], cwd=HERE.parent, check=False)
        if done.returncode != 0 or not out.exists():
            return False
        figures = json.loads(out.read_text(encoding="utf-8"))
    load.append(os.getloadavg()[0])
    about = {"load": [round(each, 1) for each in load], "took_s": round(time.time() - began)}
    _write(name, arguments, {"commit": _commit(), "date": _date(began), **about}, figures)
    return True


def _keep_earlier(name: str, arguments: list[str], file: Path, commit: str, load: list[float] | None) -> None:
    """Writes results/NAME.json of a run made apart: its date is its file's."""
    about = {"commit": commit, "date": _date(file.stat().st_mtime), "load": load, "took_s": None}
    _write(name, arguments, about, json.loads(file.read_text(encoding="utf-8")))


def _write(name: str, arguments: list[str], about: dict[str, Any], figures: Any) -> None:
    command = " ".join([".venv/bin/python", f"benchmarks/{name}.py", *arguments])
    kept = {"command": command, "machine": machine(), **about, "figures": short(figures)}
    RESULTS.mkdir(exist_ok=True)
    text = json.dumps(kept, indent=1, ensure_ascii=False) + "\n"
    (RESULTS / f"{name}.json").write_text(text, encoding="utf-8")


def short(figures: Any) -> Any:
    """Figures to four digits, without long lists and without this machine's paths."""
    if isinstance(figures, dict):
        kept = {str(key): short(value) for key, value in figures.items() if not str(key).startswith("per_")}
        return {key: value for key, value in kept.items() if value is not LEFT_OUT}
    if isinstance(figures, list):
        if len(figures) > LONGEST_LIST:
            return LEFT_OUT
        return [each for each in map(short, figures) if each is not LEFT_OUT]
    if isinstance(figures, float):
        return float(f"{figures:.4g}")
    return LEFT_OUT if isinstance(figures, str) and figures.startswith("/") else figures


LEFT_OUT = object()


def machine() -> str:
    """Processor, cores, memory, system and Python."""
    cores = os.cpu_count()
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    python = platform.python_version()
    return f"{_processor()}, {cores} cores, {memory:.0f} GB, {platform.system()}, Python {python}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _commit() -> str:
    """What is measured; pages and kept figures may have changed since."""
    changed = _output("git", "status", "--porcelain", "--", ".", ":!benchmarks/results", ":!*.md")
    return _output("git", "rev-parse", "--short=9", "HEAD") + ("-dirty" if changed else "")


def _date(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d")


def _output(*command: str) -> str:
    return subprocess.run(command, cwd=HERE.parent, capture_output=True, text=True, check=True).stdout.strip()


if __name__ == "__main__":
    main()
