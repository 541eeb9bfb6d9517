"""Zenoh's configuration of each router and service of a fleet, as JSON, which is JSON5."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from eigenscan.fleet import access
from eigenscan.runtime.configured import stated
from eigenscan.runtime.session import URGENT_BATCHES
from eigenscan.schemas.channels import CHANNELS, Role

INSTALLED = "/etc/eigenscan"
"""Folder on each machine, or in its containers, that holds its part of the fleet's folder."""
PORT = 7447
MOST_ROBOTS = 10_000
"""Links that the site's router takes; Zenoh's own limit is 1,000."""
FLOOD = 10.0
"""Factor on a channel's rate that a robot may reach: a faulty robot then costs the site as much as ten
robots.

Zenoh limits the time between two samples. Of samples that waited, for a bad link or a busy server, and arrive
together, only the first passes. A higher factor loses fewer of them.
"""
LARGEST_BYTES = 1_000_000
"""Largest message from a robot, and largest query; a raw scan has some tens of kilobytes."""
MOST_ROUTED_BYTES = 2**27
"""Of any message, which a router puts together before it asks who sent it: a map of 330,000 m2 at 5 cm."""

ROBOTS = "robots"
"""Field of `metadata`, which Zenoh leaves to users."""

SETTINGS = """\
# Settings of the services here; eigenscan-SERVICE --help has all. Yours to edit: it is written once.
site = {site}
log_format = "json"
{names}
[router]
zenoh = "{installed}/router.json5"
end_on_change = true  # systemd or Docker restarts it
{services}"""
ROBOT_NAMES = """\
robot = {robot}
zenoh = "{installed}/service.json5"
"""
ROBOT_SERVICES = """
[projector]
keep = "/var/cache/eigenscan/models"  # for a start without the site

[tracker]
keep = "/var/cache/eigenscan/floors"

[recorder]
mcap = "/var/lib/eigenscan/recordings"
rotate_minutes = 10.0  # eigenscan fleet fetch brings whole files
budget_mb = 5000  # MB; beyond it the oldest recordings are deleted
"""
SITE_NAMES = """\
instance = "site"
"""
SITE_SERVICES = """
[mapbuilder]
zenoh = "{installed}/mapbuilder.json5"
map = "{installed}/maps/map.yaml"
model = "/var/lib/eigenscan/site/model"  # built of the map; lasting changes are proposed for it

[recorder]
zenoh = "{installed}/recorder.json5"
mcap = "/var/lib/eigenscan/recordings"
budget_mb = 20000  # MB; beyond it the oldest recordings are deleted
viewer_port = 9090  # the live picture, on 127.0.0.1 only
"""

_NO_SCOUTING = {"multicast": {"enabled": False}, "gossip": {"enabled": False}}
_DEEP_QUEUES = {"queue": {"size": dict.fromkeys(("real_time", "interactive_high"), URGENT_BATCHES)}}
"""As our sessions have them by themselves, for zenohd."""
_PATIENT = {"timeout_ms": -1, "exit_on_failure": False}


def site_router(
    site: str,
    robots: Mapping[str, tuple[str, access.Air]],
    services: Mapping[Role, str],
    groups: Mapping[str, tuple[str, str]],
    hold_back_floods: bool = True,
) -> dict[str, Any]:
    """Configuration of the site's router.

    `robots`: name -> common name of its certificate, and its rates over the air. `groups`: name -> common
    name of its projector's certificate, and its robots.
    """
    most = {one.name: max((air[one.name] for _, air in robots.values()), default=0.0) for one in CHANNELS}
    return {
        "mode": "router",
        "listen": {"endpoints": [f"tls/[::]:{PORT}"]},
        "scouting": _NO_SCOUTING,
        "transport": {
            "unicast": {"max_sessions": MOST_ROBOTS},
            "link": {
                "tls": _tls("router", "listen"),
                "tx": _DEEP_QUEUES,
                "rx": {"max_message_size": MOST_ROUTED_BYTES},
            },
            "shared_memory": {"enabled": False},
        },
        "qos": {"network": [_together(site)]},
        "access_control": access.at_site(site, robots, services, groups),
        "downsampling": _limits("flood", "ingress", {"site": site}, most, FLOOD) if hold_back_floods else [],
        "low_pass_filter": [
            {
                "id": "largest message of a robot",
                "flows": ["ingress"],
                "messages": ["put"],
                "key_exprs": [f"{site}/robot/**", f"{site}/health/**"],
                "size_limit": LARGEST_BYTES,
            },
            {
                "id": "largest query",
                "flows": ["ingress"],
                "messages": ["query"],
                "key_exprs": [f"{site}/**"],
                "size_limit": LARGEST_BYTES,
            },
        ],
    }


def robot_router(
    site: str, robot: str, air: access.Air, router: str, *, served: bool = False
) -> dict[str, Any]:
    """Configuration of a robot's own router, which connects its services and its link to the site.

    Only keys that may cross the air leave for `router`. `served`: a projector on another machine answers its
    scans. It is a peer of the site's router, because routers would exchange a list of all routers of the
    site.
    """
    return {
        "mode": "peer",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{PORT}"]},
        "connect": {"endpoints": [_endpoint(router)], **_PATIENT},
        "scouting": _NO_SCOUTING,
        "transport": {"link": {"tls": _tls("robot", "connect"), "tx": _DEEP_QUEUES}},
        "access_control": access.on_robot(site, robot, air, served=served),
        "downsampling": _limits("air", "egress", {"site": site, "robot": robot}, air),
        "qos": {"network": _urgency(site, robot, air)},
    }


def robot_service() -> dict[str, Any]:
    """Configuration of a service or driver on a robot: it connects to the robot's own router only."""
    return _client(f"tcp/127.0.0.1:{PORT}")


def site_service(name: str, router: str = "localhost", robots: Sequence[str] = ()) -> dict[str, Any]:
    """A service of the site, or an operator's tool, with the certificate `name`.

    `robots`: those that the tool misses if they are not there.
    """
    return (
        _client(_endpoint(router))
        | {"transport": {"link": {"tls": _tls(name, "connect")}}}
        | ({"metadata": {ROBOTS: list(robots)}} if robots else {})
    )


def robots_in(path: Path | None) -> tuple[str, ...]:
    """The robots that a configuration names for `doctor` and `fleet status`."""
    metadata = stated(path, "metadata")
    named = metadata.get(ROBOTS) if isinstance(metadata, dict) else None
    return tuple(str(one) for one in named) if isinstance(named, list) else ()


def settings(site: str, robot: str | None = None) -> str:
    """eigenscan.toml of a robot, or of the site."""
    names, services = (ROBOT_NAMES, ROBOT_SERVICES) if robot else (SITE_NAMES, SITE_SERVICES)
    text = SETTINGS.replace("{names}", names).replace("{services}", services)
    quoted = {"site": json.dumps(site, ensure_ascii=False), "robot": json.dumps(robot, ensure_ascii=False)}
    return text.format(installed=INSTALLED, **quoted)


def group_settings(site: str, name: str, group: str) -> str:
    """eigenscan.toml of a machine with a projector for a group of robots."""
    given = {"site": site, "instance": name, "robot": group, "zenoh": f"{INSTALLED}/projector.json5"}
    lines = [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in given.items()]
    return "\n".join([*lines, 'log_format = "json"', ""])


def _limits(
    name: str, flow: str, address: Mapping[str, str], air: access.Air, slack: float = 1.0
) -> list[dict[str, Any]]:
    """Zenoh's downsampling on links over the air, of channels that are limited."""
    rules = [
        {"key_expr": one.selector(address), "freq": air[one.name] * slack}
        for one in CHANNELS
        if 0 < air[one.name] < math.inf
    ]
    if not rules:
        return []
    return [{"id": name, "link_protocols": ["tls"], "flows": [flow], "messages": ["put"], "rules": rules}]


def _urgency(site: str, robot: str, air: access.Air) -> list[dict[str, Any]]:
    """Sets priority and congestion control over the air from the table, whatever the publisher chose."""
    return [
        {
            "id": one.name,
            "link_protocols": ["tls"],
            "flows": ["egress"],
            "messages": ["put"],
            "key_exprs": [one.selector({"site": site, "robot": robot})],
            "overwrite": {
                "priority": one.qos.priority.value,
                "congestion_control": "block" if one.qos.block else "drop",
                "express": one.qos.express,
            },
        }
        for one in CHANNELS
        if Role.ROBOT in one.published_by and air[one.name] > 0
    ]


def _together(site: str) -> dict[str, Any]:
    """Lets the site's router batch the robots' samples.

    Express samples of 200 robots, 2,000 a second to each subscriber, fill Zenoh's deepest queue, of 16
    batches, whenever its thread gets no turn for 8 ms. A sample that need not wait leaves at once in both
    cases.
    """
    urgent = [one for one in CHANNELS if Role.ROBOT in one.published_by and one.qos.express]
    return {
        "id": "together",
        "flows": ["egress"],
        "messages": ["put"],
        "key_exprs": [one.selector({"site": site}) for one in urgent if not one.to_one_robot],
        "overwrite": {"express": False},
    }


def _client(endpoint: str) -> dict[str, Any]:
    return {"mode": "client", "connect": {"endpoints": [endpoint], **_PATIENT}, "scouting": _NO_SCOUTING}


def _endpoint(router: str) -> str:
    return f"tls/[{router}]:{PORT}" if ":" in router else f"tls/{router}:{PORT}"


def _tls(name: str, side: str) -> dict[str, Any]:
    return {
        "root_ca_certificate": f"{INSTALLED}/ca.crt",
        f"{side}_private_key": f"{INSTALLED}/{name}.key",
        f"{side}_certificate": f"{INSTALLED}/{name}.crt",
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }
