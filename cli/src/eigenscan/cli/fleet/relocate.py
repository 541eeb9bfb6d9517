"""`eigenscan fleet relocate`: sets a robot's pose, or restarts its search."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.cli.figures import JsonFile, prepare, wants_words, write_figures
from eigenscan.cli.names import Site
from eigenscan.runtime.errors import FailedError, UsageError
from eigenscan.schemas.channels import DEFAULT_SITE, RELOCATION, is_chunk
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, Relocation

if TYPE_CHECKING:
    from eigenscan.fleet.view import FleetView, Service

SPEED = 2.0
"""m/s that a robot may have driven on, at most, before its claim came."""
NEAR_M = 1.0
"""m between a pose and a claim that confirms it, besides its sigma and the way driven."""
TURN_SHARE = math.radians(15.0) / 0.5
"""rad per m: a click that is half a metre off is also 15 degrees off."""


def relocate(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="the robot's name")],
    pose: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y DEG", help="where its base is: m, m and degrees in the map"),
    ] = None,
    search: Annotated[bool, typer.Option("--search", help="search the whole site again")] = False,
    sigma: Annotated[float, typer.Option(min=0.01, max=100.0, help="m, how far off X and Y may be")] = 0.5,
    site: Site = DEFAULT_SITE,
    zenoh: Annotated[Path | None, typer.Option(help="Zenoh configuration, JSON5")] = None,
    seconds: Annotated[float, typer.Option(min=1.0, max=86_400.0, help="s to wait for each answer")] = 10.0,
    json_file: JsonFile = None,
    former_search: Annotated[bool, typer.Option("--anew", hidden=True)] = False,
) -> None:
    """Set a robot's pose, or restart its search, and wait for its answer.

    The next scans may contradict the pose. Exit code 0: the robot accepted it, 1: it did not, or it then
    claims another place.

    \b
    Examples:
      eigenscan fleet relocate r17 --pose 12.4 -3.0 90 --site hospital --zenoh /etc/eigenscan/operator.json5
      eigenscan fleet relocate r17 --search
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet.view import FleetView, connect

    if (pose is None) == (not (search or former_search)):
        raise UsageError("give either --pose X Y DEG or --search")
    if pose is not None and not all(map(math.isfinite, pose)):
        raise UsageError(f"--pose {pose}: give finite numbers")
    if not is_chunk(robot):
        raise UsageError(f"{robot!r}: is no robot's name; give one robot")
    prepare(json_file)
    with FleetView(connect(zenoh), site) as view:
        _wait_for_tracker(view, robot, seconds)
        before, begun = _taken_up(view, robot), time.monotonic()
        view.publish(Envelope(RELOCATION, {"site": site, "robot": robot}, _word(pose, sigma)))
        if not view.until(lambda: _taken_up(view, robot) > before, seconds):
            raise FailedError(
                f"{robot} did not answer within {seconds:.0f} s: its link is down, or --zenoh is not the "
                "operator's, or its router and the site's have an older configuration (fleet configure)"
            )
        since = time.monotonic()
        view.until(lambda: _is_sure(view, robot, since), seconds)
        found = _outcome(view, robot, pose, since)
        driven = SPEED * (time.monotonic() - begun)
    if wants_words(json_file):
        typer.echo(_words(found))
    write_figures(found, json_file)
    if (away := found.get("away_m", 0.0)) > NEAR_M + 3.0 * sigma + driven:
        raise FailedError(
            f"{robot} claims a place {away:.0f} m from --pose: its scans contradict it; give the right pose, "
            "a larger --sigma, or --search"
        )


def _word(pose: tuple[float, float, float] | None, sigma: float) -> Relocation:
    message = Relocation(timestamp=stamp(time.time_ns()))
    if pose is not None:
        message.pose.x, message.pose.y, message.pose.theta = pose[0], pose[1], math.radians(pose[2])
        turn = min(sigma * TURN_SHARE, math.pi)
        message.covariance.xx = message.covariance.yy = sigma**2
        message.covariance.tt = turn**2
    return message


def _serving(view: FleetView, robot: str) -> list[Service]:
    """The robot's live trackers whose health has arrived."""
    return [
        each
        for each in view.serving(robot)
        if each.name == "tracker" and each.contracts and each.health is not None
    ]


def _wait_for_tracker(view: FleetView, robot: str, seconds: float) -> None:
    if not view.until(lambda: bool(_serving(view, robot)), seconds):
        known = ", ".join(view.robot_names()) or "none"
        raise FailedError(f"{robot}: no tracker of it on site {view.site}; known robots: {known}")


def _taken_up(view: FleetView, robot: str) -> int:
    """Number of relocations that its trackers accepted so far, for all their robots."""
    return sum(each.counter("relocated") for each in _serving(view, robot))


def _is_sure(view: FleetView, robot: str, since: float) -> bool:
    seen = view.robots.get(robot)
    return bool(seen and seen.pose and seen.received_at > since and seen.pose.state == STATE_LOCALIZED)


def _outcome(
    view: FleetView, robot: str, given: tuple[float, float, float] | None, since: float
) -> dict[str, Any]:
    """The robot's newest pose since it accepted the relocation."""
    from eigenscan.schemas.words import state_word

    found: dict[str, Any] = {"robot": robot, "taken_up": True, "state": "unknown"}
    seen = view.robots.get(robot)
    if seen is None or seen.pose is None or seen.received_at <= since:
        return found
    pose = seen.pose
    found |= {"state": state_word(pose.state), "confidence": round(pose.confidence, 3)}
    if pose.state == STATE_LOCALIZED:
        found |= {"x": round(pose.pose.x, 3), "y": round(pose.pose.y, 3)}
        found["theta_deg"] = round(math.degrees(pose.pose.theta), 1)
        if given is not None:
            found["away_m"] = round(math.hypot(pose.pose.x - given[0], pose.pose.y - given[1]), 2)
    return found


def _words(found: dict[str, Any]) -> str:
    taken = f"{found['robot']} accepted it"
    if found["state"] == "unknown":
        return f"{taken}; no pose since then: check its scans with eigenscan doctor"
    if "x" not in found:
        return f"{taken}, and is {found['state']}, confidence {found['confidence']:.2f}"
    place = f"{found['x']:.2f}, {found['y']:.2f}, {found['theta_deg']:.0f} deg"
    away = f", {found['away_m']:.2f} m from the given pose" if "away_m" in found else ""
    return f"{taken}, and is localized at {place}{away}, confidence {found['confidence']:.2f}"
