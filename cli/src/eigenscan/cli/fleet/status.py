"""`eigenscan fleet status`: a live table of all robots of a site."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.names import Site
from eigenscan.runtime.errors import FailedError
from eigenscan.runtime.printable import printable
from eigenscan.schemas.channels import DEFAULT_SITE

if TYPE_CHECKING:
    from eigenscan.fleet.view import FleetView, Service
    from rich.console import Group

OLD_S = 3.0
"""Age of a pose, s, beyond which nobody may act on it."""
REFRESH_S = 0.5


def status(
    site: Site = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    once: Annotated[bool, typer.Option("--once", help="print the table once and end")] = False,
    seconds: Annotated[
        float, typer.Option(min=0.1, max=86_400.0, help="with --once or --json: listening time, s")
    ] = 3.0,
    json_file: JsonFile = None,
) -> None:
    """Show each robot of a site: state, confidence, pose, map, and its age. Ctrl-C ends it.

    Ages count from the arrival here, so they do not depend on the robots' clocks. With --once or --json exit
    code 1: nothing of the site answers.

    \b
    Examples:
      eigenscan fleet status --site hospital --zenoh deploy/site.json5
      eigenscan fleet status --site hospital --once
      eigenscan fleet status --site hospital --json -
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet.configuration import robots_in
    from eigenscan.fleet.view import FleetView, connect, no_service
    from rich.console import Console
    from rich.live import Live

    prepare(json_file)
    console = Console()
    with FleetView(connect(zenoh), site, robots_in(zenoh)) as view:
        if once or json_file is not None:
            view.until(lambda: False, seconds)
            if wants_words(json_file):
                console.print(table(view))
            write_figures({"site": site, "model": view.model_version, "robots": rows(view)}, json_file)
            if view.is_silent:
                raise FailedError(no_service(site))
            return
        with Live(table(view), console=console, auto_refresh=False) as live:
            try:
                while True:
                    view.until(lambda: False, REFRESH_S)
                    live.update(table(view), refresh=True)
            except KeyboardInterrupt:
                return


def rows(view: FleetView) -> list[dict[str, Any]]:
    """A row for each robot, by name."""
    now = time.monotonic()
    return [_row(view, name, now) for name in view.all_robots()]


def _row(view: FleetView, name: str, now: float) -> dict[str, Any]:
    from eigenscan.schemas.words import state_word

    robot = view.robots.get(name)
    serving = [service for service in view.serving(name) if service.contracts]
    row: dict[str, Any] = {
        "robot": name,
        "stranger": view.is_stranger(name),
        "state": "unknown",
        "confidence": None,
        "x": None,
        "y": None,
        "floor": "",
        "floor_x": None,
        "floor_y": None,
        "model": "",
        "pose_age_s": None,
        "services": {service.name: service.status for service in serving},
        "drops": sum(sum(service.drops.values()) for service in serving),
        "clock_offset_s": _clock(serving),
        "twice": sorted(service.name for service in serving if service.is_twice),
        "advice": robot.advised if robot is not None else "",
    }
    if robot is not None and robot.pose is not None:
        pose = robot.pose
        row |= {
            "state": state_word(pose.state),
            "confidence": round(pose.confidence, 3),
            "x": round(pose.pose.x, 3),
            "y": round(pose.pose.y, 3),
            "model": pose.model_version,
            "pose_age_s": round(now - robot.received_at, 2),
        }
        if pose.floor:
            row |= {
                "floor": pose.floor,
                "floor_x": round(pose.floor_pose.x, 3),
                "floor_y": round(pose.floor_pose.y, 3),
            }
    return row


def _clock(serving: list[Service]) -> float | None:
    offsets = [each.clock_offset_s for each in serving if each.clock_offset_s is not None]
    worst = max(offsets, key=abs, default=None)
    return None if worst is None else round(worst, 2)


def table(view: FleetView) -> Group:
    """The rows as a table that fits 80 columns; red and yellow cells name what needs attention."""
    from rich.console import Group
    from rich.table import Table
    from rich.text import Text

    found = rows(view)
    sure = sum(row["state"] == "localized" and (row["pose_age_s"] or 0) <= OLD_S for row in found)
    title = f"site {view.site}: {sure} of {len(found)} robots localized"
    shown = Table(title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    for heading in ("robot", "state", "confidence", "x, y (m)", "age", "map"):
        shown.add_column(
            heading, justify="right" if heading in ("confidence", "age") else "left", no_wrap=True
        )
    shown.add_column("health")
    for row in found:
        shown.add_row(*_cells(row, view.model_version))
    below = [f"{printable(row['robot'])}: {row['advice']}" for row in found if row["advice"]]
    if not found:
        below = ["no robot answers: eigenscan doctor shows why"]
    return Group(shown, *map(Text, below))  # a caption would be as narrow as the table


def _cells(row: dict[str, Any], newest: str) -> list[str]:
    from rich.markup import escape

    age = row["pose_age_s"]
    old = age is not None and age > OLD_S
    colour = "red" if old or row["state"] in ("lost", "unknown") else _COLOURS.get(row["state"], "yellow")
    state = f"[{colour}]{'was ' if old else ''}{row['state']}[/]"
    place = "" if row["x"] is None else f"{row['x']:.1f}, {row['y']:.1f}"
    if row["floor"]:  # in the floor's own map
        place = f"{row['floor_x']:.1f}, {row['floor_y']:.1f} on {escape(printable(row['floor']))}"
    model = printable(row["model"][:8])
    if newest and model and row["model"] != newest:
        model = f"[yellow]{model} old[/]"
    confidence = "" if row["confidence"] is None else f"{row['confidence']:.2f}"
    name = escape(printable(row["robot"]))
    return [name, state, confidence, place, age_text(age), model, _health(row)]


_COLOURS = {"localized": "green", "ambiguous": "yellow"}


def _health(row: dict[str, Any]) -> str:
    """Missing and unwell services, drops and a wrong clock, or `ok`."""
    from eigenscan.fleet.view import ROBOT_SERVICES

    if not row["services"]:
        return "[red]not there[/]"
    troubles = ["[red]revoked or new[/]"] if row["stranger"] else []
    troubles += [f"[red]no {name}[/]" for name in ROBOT_SERVICES if name not in row["services"]]
    troubles += [f"[yellow]{name} {word}[/]" for name, word in row["services"].items() if word != "ok"]
    troubles += [f"[red]{name} twice[/]" for name in row["twice"]]
    if row["drops"]:
        troubles.append(f"[yellow]{row['drops']} drops[/]")
    offset = row["clock_offset_s"]
    if offset is not None and abs(offset) > OLD_S:
        troubles.append(f"[red]clock {offset:+.0f} s[/]")
    return ", ".join(troubles) or "ok"


def age_text(seconds: float | None) -> str:
    """An age with its unit; empty for None."""
    if seconds is None:
        return ""
    if seconds < 60:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.0f} h"
