"""The figures for a reader: one table."""

from __future__ import annotations

from typing import Any

from eigenscan.workbench.evaluation.doubt import RULE
from eigenscan.workbench.evaluation.explained import LITTLE
from eigenscan.workbench.evaluation.figures import Figures
from eigenscan.workbench.evaluation.own_reference import WHOLE_DRIVE
from eigenscan.workbench.logs.remarks import remarks as of_reading
from rich.console import Console
from rich.table import Table

FEW = 10
"""Scans apart, below which stated errors are not judged: one log of 23 s gave a verdict by a single scan."""


def show(figures: Figures, title: str, console: Console) -> None:
    """Prints the headline figures, the windows that went wrong, the warnings, and the verdict last."""
    table = Table(title=title, title_justify="left", show_header=False, box=None, pad_edge=False)
    for name, value in _lines(figures):
        table.add_row(name, value)
    console.print(table)
    bad = [row for row in figures["per_window"] or [] if not row["success"] or row["false_claims"]]
    if bad:
        console.print(_windows(bad, _words(figures)))
    for line in (*(f"warning: {remark}" for remark in remarks(figures)), verdict(figures)):
        console.print(line, highlight=False)


def verdict(f: Figures) -> str:
    """One sentence that sums up the figures."""
    if not f["windows"] or f["success_rate"] is None:
        return "Verdict: no window could be judged."
    good = round(f["success_rate"] * f["windows"])
    wrong = round((f["false_claim_rate"] or 0.0) * f["windows"])
    scans = _number(f["to_localize"]["scans"]["median"])
    after = f", typically after {scans} scans" if good else ""
    if f["reference"] == WHOLE_DRIVE:
        return (
            f"Verdict: {good} of {f['windows']} starts agree with the log played as a whole{after}; "
            f"{wrong} disagree at some claim. This shows agreement, not accuracy."
        )
    return f"Verdict: {good} of {f['windows']} starts succeed{after}; {wrong} have a false claim."


def remarks(f: Figures) -> list[str]:
    """Points to check before one trusts the figures."""
    found = []
    if f["log"]["odometry"] == 0:
        found.append("the log has no odometry: the scans alone were used")
    # no such figure in results of earlier releases
    found += [f"in the log, {line}" for line in of_reading(f["log"].get("set_aside", {}))]
    found += [_reported(f, words, row) for words, row in f.get("reported", {}).items()]
    if frame := f.get("reference_frame"):  # no such figure in results of earlier releases
        found.append(
            f"{frame['right_share']:.0%} of the claims are right once the reference is turned by "
            f"{frame['heading_deg']:.1f}° and then moved by {frame['x_m']:.2f} m, {frame['y_m']:.2f} m: "
            "is it in another frame than the map? Transform it so, and evaluate again"
        )
    explains = f["map_explains"]["median"]
    if explains is not None and explains < LITTLE:
        found.append(
            f"the map explains only {100 * explains:.0f} % of what the lidar sees at claimed poses: are "
            "walls missing, moved or of glass, or is the map old?"
        )
    apart = f["normalised_innovation_squared"]["consistency"]
    if apart["mean"] is not None and apart["high"] is not None and apart["mean"] > apart["high"]:
        found.append(
            "odometry and scans disagree by more than their error allows: check the lidar's mount (eigenscan "
            "import --mount) and the odometry (--odometry-topic)"
        )
    return found


def _reported(f: Figures, words: str, row: Figures) -> str:
    """A fault that health reported in some windows, or only in the whole drive, and what may mend it."""
    where = f" for {row['seconds']:.0f} s of the whole drive"
    if row["runs"]:
        windows = f["per_window"]
        played = sum(each["end"] - each["start"] for each in windows)
        where = f" for {row['seconds']:.0f} s of {played:.0f}, in {row['runs']} of {len(windows)} windows"
    mends = " (eigenscan import --mount, --odometry-topic)" if "odometry" in words or "mount" in words else ""
    return f"health reported{where}: {words}{mends}"


def _words(f: Figures) -> dict[str, str]:
    """Names of success and false claims: agreement and disagreement without a reference."""
    if f["reference"] == WHOLE_DRIVE:
        return {"success": "agreement", "right": "agreeing", "false": "disagreeing", "off": "difference"}
    return {"success": "success", "right": "right", "false": "false", "off": "error"}


def _lines(f: Figures) -> list[tuple[str, str]]:
    words = _words(f)
    reach, first, error = f["to_localize"], f["first_right_claim"], f["error"]
    own = f["reference"] == WHOLE_DRIVE
    lines = [
        ("reference", f["reference"] + (": agreement, not accuracy" if own else "")),
        ("windows", f"{f['windows']} ({f['windows_left_out']} left out)"),
        (
            words["success"],
            f"{_percent(f['success_rate'])}: claimed and {words['right']} for the last third or more",
        ),
        (f"windows with {words['right']} claims", _percent(f["right_claim_rate"])),
        (f"windows with {words['false']} claims", _percent(f["false_claim_rate"])),
        (f"share of {words['false']} claims", _percent(f["false_share_of_claims"], 2)),
        (
            "of claims, at another place",
            f"{_percent(f['elsewhere_share_of_claims'], 2)}: over 1 m or 20° off",
        ),
        *_doubt(f.get("reference_in_doubt")),
        (f"to {words['success']}, median", _reached(reach, "median")),
        (f"to {words['success']}, 95 % within", _reached(reach, "p95")),
        (f"to the first {words['right']} claim, median", _reached(first, "median")),
        (f"position {words['off']}, m", _pair(error["position_m"], "p95")),
        (f"heading {words['off']}, deg", _pair(error["heading_deg"], "p95")),
        ("beams that the map explains, at claims", _explains(f["map_explains"])),
        ("calibration error", _percent(f["calibration_error"])),
    ]
    if not own:  # an estimate is not normally distributed about itself
        consistency = f["normalised_error_squared"]["consistency"]
        lines.append(("normalised error squared (NEES)", _consistency(consistency)))
    lines.append(
        (
            "normalised innovation squared (NIS)",
            _consistency(f["normalised_innovation_squared"]["consistency"]),
        )
    )
    if f["kidnap"]:
        kidnap = f["kidnap"]
        lines += [
            (
                "kidnaps: right for good within 3 s",
                f"{_percent(kidnap['recovered_within_3_s'])} of {kidnap['kidnaps']}",
            ),
            *_decided(kidnap),
            ("kidnaps: a first right claim within 3 s", _percent(kidnap["first_right_within_3_s"])),
            ("kidnaps: right from some scan on", _percent(kidnap["recovered_rate"])),
            ("noticed, s", _pair(kidnap["noticed_s"], "p95")),
            ("right for good, s", _pair(kidnap["recovered_s"], "p95")),
            ("first right claim, s", _pair(kidnap["first_right_s"], "p95")),
        ]
    if f["single_scan"]:
        single = f["single_scan"]
        listed = f"{_percent(single['in_list'])} (of {_number(single['list_length'])})"
        lines += [
            ("single scan, first is right", f"{_percent(single['top1'])} of {single['n']}"),
            ("single scan, right is listed", listed),
            ("single scan, CPU ms", _pair(single["cpu_ms"], "p99")),
        ]
        if single["exhaustive_n"]:
            right = f"{_percent(single['exhaustive_top1'])} of {single['exhaustive_n']}"
            lines += [
                ("exhaustive, first is right", right),
                ("exhaustive, CPU ms", _pair(single["exhaustive_cpu_ms"], "p99")),
            ]
    lines += [
        ("CPU a scan, ms", _pair(f["cpu_ms_per_scan"], "p99")),
        ("peak memory, MB", _number(f["peak_rss_mb"])),
        ("map, m²", _number(f["map_m2"])),
    ]
    if f["model"]:
        lines.append(("model", _model(f["model"])))
    # columns that a table of poses cannot have
    return [line for line in lines if "poses" not in f or not line[1].startswith(("-", "mean -"))]


def _model(model: Figures) -> str:
    memory = "" if model["memory_mb"] is None else f", {_number(model['memory_mb'])} MB in memory"
    built = "as in the folder" if model["build_s"] is None else f"built in {_number(model['build_s'])} s"
    apart = f"positions {_number(model['spacing_m'])} m apart"
    return f"{built}, {apart}, {_number(model['wire_mb'])} MB on the wire{memory}"


def _explains(found: Figures) -> str:
    return f"{_percent(found['median'])}; at 95 % of the claims more than {_percent(found['p5'])}"


def _consistency(found: Figures) -> str:
    mean, low, high = found["mean"], found["low"], found["high"]
    text = f"mean {_number(mean)} of {found['n']} scans {found['apart_m']:g} m apart"
    if mean is None or low is None or high is None:
        return text
    if found["n"] < FEW:
        return f"{text}: too few to judge"
    if low <= mean <= high:
        return f"{text}: stated errors are right"
    fit = "too large" if mean < low else "too small"
    return f"{text}: stated errors are {fit} ({_number(low)} to {_number(high)} would be right)"


def _windows(rows: list[Figures], words: dict[str, str]) -> Table:
    title = f"the windows without {words['success']}, or with a {words['false']} claim"
    table = Table(
        *("window", "scans", "m", words["success"], f"{words['false']} claims"),
        *(f"{words['right']} poses", "localized"),
        f"last {words['off']}",
        box=None,
        title=title,
        title_justify="left",
    )
    for row in rows:
        last = row["last"]
        table.add_row(
            f"{row['start']:.2f}",
            str(row["scans"]),
            _number(row["metres"]),
            "yes" if row["success"] else "no",
            str(row["false_claims"]),
            _percent(row["right_share"]),
            _percent(row["localized_share"]),
            f"{last['position_m']:.2f} m, {last['heading_deg']:.1f}°" if last else "-",
        )
    return table


def _number(value: Any) -> str:
    if value is None:
        return "-"
    if abs(value) < 1e-4:
        return "0"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _doubt(found: Figures | None) -> list[tuple[str, str]]:
    if not found or not found["claims"]:
        return []
    return [
        ("of these, reference in doubt", f"{found['claims']} claims in {found['windows']} windows: {RULE}")
    ]


def _decided(kidnap: Figures) -> list[tuple[str, str]]:
    if not kidnap["decided"]:
        return []
    share = _percent(kidnap["recovered_within_3_s_of_decided"])
    return [("of those that 3 s of scans decide", f"{share} of {kidnap['decided']}")]


def _percent(value: float | None, digits: int = 1) -> str:
    return "-" if value is None else f"{100 * value:.{digits}f} %"


def _pair(values: Figures, upper: str) -> str:
    return f"{_number(values['median'])}; {upper[1:]} % within {_number(values[upper])}"


def _reached(reach: Figures, which: str) -> str:
    values = (_number(reach[name][which]) for name in ("scans", "metres", "seconds"))
    return "{} scans, {} m, {} s".format(*values) if reach["scans"][which] is not None else "-"
