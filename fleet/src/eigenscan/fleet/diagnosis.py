"""Finds faults of a site from its services' reports, and the fix for each."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass

from eigenscan.fleet.view import ROBOT_SERVICES, FleetView, Service
from eigenscan.schemas.channels import CONTRACT_VERSION
from eigenscan.schemas.health_pb2 import Health

CLOCK_S = 1.0
"""Largest difference between a robot's clock and ours, with a message's travel time."""
ROS_BRIDGE = "ros-bridge"
SILENT_S = 3.0
"""Age of a service's newest health beyond which the service or its link is not well."""


_PART = re.compile(r"(\d{1,3})/(\d{1,3})", re.ASCII)
"""A projector's setting `part`: its share of the site, as k/n."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    where: str
    what: str
    mend: str


def diagnose(view: FleetView) -> list[Finding]:
    """All findings of a view that has listened for some seconds."""
    if not any(service.contracts for service in view.services.values()):
        return [
            Finding(
                f"site {view.site}",
                "no service of this site is reachable",
                "start the services, or give the --site and --zenoh that they use",
            )
        ]
    found = [*_of_the_site(view)]
    for service in view.services.values():
        found += _of_a_service(service)
    robots = view.all_robots()
    if not robots:
        found.append(
            Finding(f"site {view.site}", "no robot is there", "start a robot's services, or name it: --robot")
        )
    for robot in robots:
        found += _of_a_robot(view, robot)
    return found


def _of_the_site(view: FleetView) -> Iterator[Finding]:
    builders = [each for each in view.services.values() if each.name == "mapbuilder" and each.contracts]
    where = f"site {view.site}"
    routers = [each.instance for each in view.services.values() if each.name == "router" and each.contracts]
    if not builders and view.model_version:
        return  # a robot's certificate shows no mapbuilder, only what it sends
    if not builders and routers == view.robot_names():
        yield Finding(
            where,
            f"no models reach {routers[0]}: its link passes nothing, its certificate may be revoked, or "
            "there is no mapbuilder",
            f"at the site: eigenscan doctor --site {view.site} --zenoh FILE, with the operator's file",
        )
    elif not builders:
        yield Finding(
            where,
            "no mapbuilder: a projector that starts now gets no model",
            f"eigenscan-mapbuilder --site {view.site} --model MODEL (made by eigenscan build)",
        )
    elif not view.model_version:
        yield Finding(where, "no models yet", "wait for mapbuilder, or see its log")
    elif len(builders) > 1 and len(set(view.model_versions)) > 1:
        both = " and ".join(sorted(each.instance for each in builders))
        yield Finding(where, f"mapbuilders {both} publish different models", "end all but one")


def _of_a_service(service: Service) -> Iterator[Finding]:
    where = f"{service.name} {service.instance}"
    for contract in sorted(service.contracts - {str(CONTRACT_VERSION)}):
        yield Finding(
            where,
            f"speaks version {contract} of the contract, this command {CONTRACT_VERSION}",
            "bring both to the same release",
        )
    health = service.health
    if not service.contracts or health is None:
        return
    if time.monotonic() - service.received_at > SILENT_S:
        yield Finding(
            where, "is alive, but publishes no health", "see its log; machine or link may be overloaded"
        )
    if service.is_twice:
        yield Finding(
            where,
            "two machines publish under this name, or it restarts every few seconds",
            "a certificate is for one machine: certify another robot (docs/fleet.md); else see its log",
        )
    offset = service.clock_offset_s or 0.0
    if abs(offset) > CLOCK_S:
        yield Finding(
            where,
            f"its clock is {abs(offset):.0f} s {'ahead' if offset > 0 else 'behind'}",
            "synchronise the machines' clocks (chrony or systemd-timesyncd)",
        )
    if health.status == Health.STATUS_DEGRADED:
        yield Finding(where, health.detail or "degraded", "see its log")
    if lost := service.grew("undecodable"):
        yield Finding(
            where,
            f"could not decode {lost} messages",
            "a sender has another version: its log names the keys",
        )
    for channel, dropped in service.drops.items():
        if service.grew(f"dropped_{channel}"):
            yield Finding(
                where,
                f"is too slow: drops {channel}, {dropped} so far",
                "give it more CPU time, or fewer robots (--robot) or regions (--part)",
            )


def _of_missing_scans(view: FleetView, robot: str) -> Iterator[Finding]:
    """Where a bridge serves the robot, its scans come from ROS."""
    where = f"robot {robot}"
    for bridge in view.serving(robot, (ROS_BRIDGE,)):
        if bridge.status == "waiting" and bridge.health is not None:
            yield Finding(
                where,
                f"no scans arrive, ros-bridge: {bridge.health.detail}",
                "start the lidar's driver in ROS, and rmw_zenohd or zenoh-bridge-ros2dds at its ros_router",
            )
            return
    yield Finding(
        where,
        "no scans arrive",
        f"let the lidar's driver publish on {view.site}/robot/{robot}/scan/raw/LIDAR",
    )


def _of_a_robot(view: FleetView, robot: str) -> Iterator[Finding]:
    where = f"robot {robot}"
    if view.is_stranger(robot):
        yield Finding(
            where,
            "is not of this fleet: revoked, or new",
            "revoked: copy the fleet's site/router.json5 to the router; new: operator/operator.json5 to here",
        )
    there: dict[str, list[Service]] = {name: [] for name in ROBOT_SERVICES}
    for service in view.serving(robot):
        if service.contracts:
            there[service.name].append(service)
    if not any(there.values()):
        yield Finding(
            where,
            "nothing of it is there: it or its link is off",
            f"on the robot: eigenscan doctor --site {view.site} --zenoh FILE, with the file of its services",
        )
        return
    for name, services in there.items():
        if not services:
            yield Finding(
                where,
                f"no {name}",
                f"start it: eigenscan-{name} --site {view.site} --robot {robot} --zenoh FILE",
            )
    yield from _of_sharing(where, there)
    if there["scan-ingest"] and not any(each.grew("heard_scan_raw") for each in there["scan-ingest"]):
        yield from _of_missing_scans(view, robot)
        return
    if there["projector"] and all(_lacks_model(each) for each in there["projector"]):
        detail = next(each.health.detail for each in there["projector"] if each.health is not None)
        yield Finding(where, f"projector: {detail}", "start mapbuilder, or check the link to the site")
    if any(each.grew("heard_hypotheses") for each in there["tracker"]) and not any(
        each.grew("heard_odometry") for each in there["tracker"]
    ):
        yield Finding(
            where,
            "no odometry arrives: it localizes, but more slowly and less surely",
            f"publish it on {view.site}/robot/{robot}/odom",
        )
    known = view.robots.get(robot)
    if known is not None and known.pose is not None and known.is_old(view.model_version):
        yield Finding(
            where,
            f"uses model {known.pose.model_version[:8]}, the site's newest is {view.model_version[:8]}",
            "wait half a minute; if nothing changes, check the link and restart its projector",
        )


def _of_sharing(where: str, there: dict[str, list[Service]]) -> Iterator[Finding]:
    """Services that publish for one robot on the same key, and parts of the site without a projector."""
    for name in ("scan-ingest", "tracker"):
        if len(there[name]) > 1:
            both = " and ".join(sorted(service.instance for service in there[name]))
            yield Finding(where, f"has {name} {both}: both publish on the same keys", "end all but one")
    shares: dict[int, set[int]] = {}
    for service in there["projector"]:
        if found := _PART.fullmatch(service.setting("part", "1/1")):
            k, n = map(int, found.groups())
            shares.setdefault(n, set()).add(k)
    missing = {n: sorted({*range(1, n + 1)} - held) for n, held in shares.items()}
    if missing and all(missing.values()):
        n, lacking = min(missing.items(), key=lambda each: len(each[1]))
        words = ", ".join(f"{k}/{n}" for k in lacking)
        yield Finding(
            where,
            f"no projector searches part {words} of the site",
            f"start one with --part {lacking[0]}/{n}",
        )


def _lacks_model(projector: Service) -> bool:
    return projector.health is not None and projector.health.status == Health.STATUS_WAITING
