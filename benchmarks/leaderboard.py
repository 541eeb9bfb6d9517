"""The leaderboard: other programs on our windows, judged by `eigenscan evaluate --poses`.

    .venv/bin/python benchmarks/leaderboard.py                              # the tables, from what was kept
    .venv/bin/python benchmarks/leaderboard.py --run mrpt_pf_localization --only intel [--particles 10000]

A peer is a program in benchmarks/peers: RUNS MAP.yaml --poses OUT.csv. Its table of poses begins with the
comments `# system: NAME` and `# settings: WORDS`. The figures are kept in benchmarks/results/peers, a file a
system; benchmarks/record.py writes the tables into docs/comparison.md. What was measured elsewhere is there
too, marked so: no program here prints it.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from record import machine, short

HERE = Path(__file__).parent
RESULTS = HERE / "results"
DATASETS = HERE.parents[1] / "shared/datasets"
LOGS = {
    "intel": ("intel/log.clf.gz", "intel/log.tum"),
    "fr079": ("fr079/log.clf.gz", "fr079/log.tum"),
    "jarvis": ("jarvis/jarvis_complex_path_fast.bag", "jarvis/jarvis_complex_path_fast.tum"),
}
KEPT = ("windows", "success_rate", "false_claim_rate", "to_localize", "error", "calibration_error", "kidnap")
COLUMNS = ("", "success", "windows with a false claim", "scans", "error, median", "CPU a scan", "measured")
EIGENSCAN = str(Path(sys.executable).parent / "eigenscan")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--run", metavar="PEER", help="a program in benchmarks/peers")
    parser.add_argument("--only", choices=sorted(LOGS), action="append", help="may be given again")
    parser.add_argument("--datasets", type=Path, default=DATASETS)
    parser.add_argument(
        "--poses", type=Path, help="what the peer wrote before, instead of a run; with --only"
    )
    parser.add_argument(
        "--no-cpu", action="store_true", help="keep no CPU time: the machine has other work meanwhile"
    )
    given, options = parser.parse_known_args()
    if given.run:
        for name in given.only or LOGS:
            _keep(given.run, options, name, given.datasets, given.poses, with_cpu=not given.no_cpu)
    print("\n".join(f"## {log}\n\n{table(log)}\n" for log in logs()))


def _keep(
    peer: str, options: list[str], name: str, datasets: Path, earlier: Path | None, *, with_cpu: bool
) -> None:
    """Runs a peer on a log and keeps its figures; `options` are the peer's own."""
    program = HERE / f"peers/{peer}.py"
    if not program.exists():
        sys.exit(f"{program}: no such peer")
    log, reference = (datasets / place for place in LOGS[name])
    command = [EIGENSCAN, "evaluate", str(log), "--ground-truth", str(reference)]
    windows = log.parent / "windows.csv"
    command += ["--windows", str(windows)] if windows.exists() else []
    with tempfile.TemporaryDirectory() as scratch:
        runs, poses, out = (Path(scratch) / each for each in ("runs", "poses.csv", "figures.json"))
        if earlier is None:
            subprocess.run([*command, "--save-runs", str(runs)], check=True)
            subprocess.run(
                [sys.executable, program, runs, log.parent / "map.yaml", "--poses", poses, *options],
                check=True,
            )
        subprocess.run([*command, "--poses", str(earlier or poses), "--json", str(out)], check=True)
        figures = json.loads(out.read_text(encoding="utf-8"))
        about = described(earlier or poses)
    file = RESULTS / "peers" / f"{re.sub(r'[^a-z0-9]+', '_', about['system'].lower())}.json"
    kept = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {"logs": {}}
    kept |= {
        **about,
        "measured": "here",
        "command": " ".join(["benchmarks/leaderboard.py", "--run", peer, *options]),
    }
    kept["logs"][name] = {
        "date": datetime.now(UTC).strftime("%Y-%m-%d"),
        "machine": machine(),
        **{each: short(figures[each]) for each in (*KEPT, *(("cpu_ms_per_scan",) if with_cpu else ()))},
    }
    if not with_cpu:
        kept["logs"][name]["to_localize"].pop("cpu_s", None)
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(kept, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def described(poses: Path) -> dict[str, str]:
    """What the comments at the top of a table of poses show: `# system: NAME` and `# settings: WORDS`."""
    lines = poses.read_text(encoding="utf-8").splitlines()[:10]
    found = dict(re.findall(r"^# (system|settings): (.+)$", "\n".join(lines), re.MULTILINE))
    if "system" not in found:
        sys.exit(f"{poses}: begin with the line `# system: NAME, SETTINGS`")
    return found


def _systems() -> Iterator[dict[str, Any]]:
    own = json.loads((RESULTS / "evaluate.json").read_text(encoding="utf-8"))
    yield {"system": "**Eigenscan**", "measured": "here", "logs": own["figures"]}
    for file in sorted((RESULTS / "peers").glob("*.json")):
        yield json.loads(file.read_text(encoding="utf-8"))


def logs() -> list[str]:
    """Logs with a peer beside us, in the order of LOGS."""
    return [log for log in LOGS if sum(log in system["logs"] for system in _systems()) > 1]


def table(log: str) -> str:
    """The systems on one log, the best first, as Markdown."""
    found = [(system, system["logs"][log]) for system in _systems() if log in system["logs"]]
    found.sort(key=lambda each: (-each[1]["success_rate"], each[0]["system"]))
    rows = [list(COLUMNS), ["---"] * len(COLUMNS)]
    rows += [[system["system"], *_cells(figures), system["measured"]] for system, figures in found]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _cells(figures: dict[str, Any]) -> list[str]:
    def cell(place: str, form: str, scale: float = 1.0) -> str:
        value: Any = figures
        for step in place.split("/"):
            value = value.get(step) if isinstance(value, dict) else None
        return "\N{EN DASH}" if value is None else form.format(value * scale)

    return [
        cell("success_rate", "{:.0f} %", 100),
        cell("false_claim_rate", "{:.0f} %", 100),
        cell("to_localize/scans/median", "{:.0f}"),
        cell("error/position_m/median", "{:.1f} cm", 100) + cell("error/heading_deg/median", ", {:.1f}°"),
        cell("cpu_ms_per_scan/median", "{:.1f} ms"),
    ]


if __name__ == "__main__":
    main()
