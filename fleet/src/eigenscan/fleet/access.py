"""Rights at routers: who may publish and receive what, as Zenoh's access control, from the contract's table.

Everything else is denied, for each certificate by its common name. Zenoh reports nothing: a denied sample
does not arrive, and a denied query gets no answer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from eigenscan.schemas.channels import (
    ALIVE_TEMPLATE,
    CHANNELS,
    HEALTH,
    HYPOTHESES,
    LATCHED_TEMPLATE,
    LIDAR_KIND,
    OBSTACLES,
    RECORDINGS_TEMPLATE,
    SCAN,
    Channel,
    Role,
)
from eigenscan.schemas.group import holds, selectors

EVERY_MESSAGE = [
    "put", "delete", "declare_subscriber", "query", "reply", "declare_queryable",
    "liveliness_token", "liveliness_query", "declare_liveliness_subscriber",
]  # fmt: skip

ON_A_ROBOT = (
    "router",
    "scan-ingest",
    "projector",
    "tracker",
    "mapbuilder",
    "recorder",
    "ros-bridge",
    "vda5050-bridge",
)
"""Services that a robot's certificate may speak of: invented names would fill the site's recordings."""

ANSWERS = (HYPOTHESES, OBSTACLES)
"""Channels on which a projector answers a robot."""

Air = Mapping[str, float]
"""Channel name -> samples a second that a robot may send over the air, for every channel."""


@dataclass(frozen=True)
class Rights:
    """Key expressions that one holder of a certificate may use at the site's router."""

    site: str
    outputs: tuple[str, ...]
    answers: tuple[str, ...]
    shows: tuple[str, ...]
    inputs: tuple[str, ...]
    subscribes: tuple[str, ...]
    asks: tuple[str, ...]
    sees: tuple[str, ...]

    def rules(self, name: str, *, at_site: bool) -> list[dict[str, Any]]:
        """Zenoh's rules for the link to this holder; if not `at_site`, for its own link to the site."""
        there, back = ("ingress", "egress") if at_site else ("egress", "ingress")
        watch = ["declare_liveliness_subscriber", "liveliness_query"]
        wanted: list[tuple[str, list[str], tuple[str, ...]]] = [
            (there, ["put"], self.outputs),
            (there, ["reply", "declare_queryable"], self.answers),
            (back, ["query"], self.answers),
            (there, ["liveliness_token"], self.shows),
            # a subscription itself may be known: the put decides who receives
            (back, ["declare_subscriber", *watch], (f"{self.site}/**",)),
            (back, ["put"], self.inputs),
            (there, ["declare_subscriber"], self.subscribes),
            (back, ["reply", "declare_queryable"], self.asks),
            (there, ["query"], self.asks),
            (back, ["liveliness_token"], self.sees),
            (there, watch, (*self.subscribes, *self.sees)),
        ]
        return [
            {
                "id": f"{name} {flow} {messages[0]}",
                "permission": "allow",
                "flows": [flow],
                "messages": messages,
                "key_exprs": list(keys),
            }
            for flow, messages, keys in wanted
            if keys
        ]


def of_robot(site: str, robot: str, air: Air, *, served: bool = False) -> Rights:
    """A robot publishes its own keys that cross the air, and receives keys for all robots or for itself.

    `served`: a projector on another machine answers its scans.
    """
    outputs = [one for one in CHANNELS if Role.ROBOT in one.published_by and air[one.name] > 0]
    inputs = [one for one in CHANNELS if Role.ROBOT in one.received_by or (served and one in ANSWERS)]
    # its services are instances of the robot's name
    address = {"site": site, "robot": robot, "instance": robot}
    return Rights(
        site,
        outputs=tuple(
            one.selector(address | {"service": service})
            for one in outputs
            for service in (ON_A_ROBOT if one is HEALTH else ("*",))
        ),
        answers=(_recordings(site, robot),),
        shows=tuple(_alive(site, robot, service) for service in ON_A_ROBOT),
        inputs=_keys(inputs, address),
        # a rule holds for a subscription as it stands: one for all robots brings this robot's
        subscribes=_keys(inputs, {"site": site}),
        asks=_keys([one for one in inputs if one.qos.latched], address),
        sees=_tokens(inputs, site),
    )


def of_service(site: str, role: Role) -> Rights:
    """A service of the site receives all keys, and publishes those that the table allows."""
    outputs = [one for one in CHANNELS if role in one.published_by]
    inputs = [one for one in CHANNELS if role in one.received_by]
    # on health, which robots publish too, it may use its own name only
    address = {"site": site, "service": role.value}
    return Rights(
        site,
        outputs=_keys(outputs, address),
        answers=_keys([one for one in outputs if one.qos.latched], address),
        shows=(*_tokens(outputs, site), *([_alive(site, service=role.value)] if HEALTH in outputs else [])),
        inputs=_keys(inputs, {"site": site}),
        subscribes=(f"{site}/**",),  # a recorder counts messages outside the contract
        asks=(
            *_keys([one for one in inputs if one.qos.latched], {"site": site}),
            *([_recordings(site)] if role is Role.OPERATOR else []),
        ),
        sees=(*_tokens(inputs, site), _alive(site)),
    )


def of_projector(site: str, group: str, name: str) -> Rights:
    """A projector `name` receives maps, models and its robots' scans, and answers these robots alone."""
    inputs = [SCAN, *(one for one in CHANNELS if one.qos.latched)]
    address = {"site": site, "robot": group, "projector": name, "service": "projector", "instance": name}

    def keys(channels: Sequence[Channel]) -> tuple[str, ...]:
        return tuple(key for one in channels for key in selectors(one, address))

    return Rights(
        site,
        outputs=keys([*ANSWERS, LIDAR_KIND, HEALTH]),
        answers=(),
        shows=(_alive(site, name, "projector"),),
        inputs=keys(inputs),
        subscribes=keys([*inputs, HEALTH]),  # health of its own name, to notice a duplicate
        asks=keys([one for one in inputs if one.qos.latched]),
        sees=_tokens(inputs, site),
    )


def at_site(
    site: str,
    robots: Mapping[str, tuple[str, Air]],
    services: Mapping[Role, str],
    groups: Mapping[str, tuple[str, str]],
) -> dict[str, Any]:
    """Access control of the site's router.

    `robots`: name -> common name of its certificate, and its rates over the air. `services`: common names.
    `groups`: name -> common name of its projector's certificate, and its robots.
    """
    holders = {
        name: (common_name, of_robot(site, name, air, served=is_served(name, groups)))
        for name, (common_name, air) in robots.items()
    }
    # no robot's name has a dot in it
    holders |= {
        f"site.{role.value}": (common_name, of_service(site, role)) for role, common_name in services.items()
    }
    holders |= {
        f"group.{name}": (common_name, of_projector(site, group, name))
        for name, (common_name, group) in groups.items()
    }
    return _control(
        {
            name: ({"cert_common_names": [common_name]}, own.rules(name, at_site=True))
            for name, (common_name, own) in holders.items()
        }
    )


def is_served(robot: str, groups: Mapping[str, tuple[str, str]]) -> bool:
    """Whether a projector elsewhere answers this robot's scans."""
    return any(holds(group, robot) for _, group in groups.values())


def on_robot(site: str, robot: str, air: Air, *, served: bool) -> dict[str, Any]:
    """Access control of a robot's own router: everything among its services, by its rights over the air."""
    inside = {
        "id": "inside",
        "permission": "allow",
        "flows": ["ingress", "egress"],
        "messages": EVERY_MESSAGE,
        "key_exprs": ["**"],
    }
    return _control(
        {
            "air": (
                {"link_protocols": ["tls"]},
                of_robot(site, robot, air, served=served).rules("air", at_site=False),
            ),
            "inside": ({"link_protocols": ["tcp"]}, [inside]),
        }
    )


def _control(subjects: Mapping[str, tuple[dict[str, Any], list[dict[str, Any]]]]) -> dict[str, Any]:
    """Zenoh's `access_control`: subject -> its identification and rules; all else is denied."""
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for _, rules in subjects.values() for rule in rules],
        "subjects": [{"id": name, **subject} for name, (subject, _) in subjects.items()],
        "policies": [
            {"subjects": [name], "rules": [rule["id"] for rule in rules]}
            for name, (_, rules) in subjects.items()
        ],
    }


def _keys(channels: list[Channel], address: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(one.selector(address) for one in channels)


def _tokens(channels: list[Channel], site: str) -> tuple[str, ...]:
    names = [one.name for one in channels if one.qos.latched]
    return tuple(LATCHED_TEMPLATE.format(site=site, channel=name, session="*") for name in names)


def _recordings(site: str, robot: str = "*") -> str:
    return RECORDINGS_TEMPLATE.format(site=site, robot=robot, what="*")


def _alive(site: str, instance: str = "*", service: str = "*") -> str:
    return ALIVE_TEMPLATE.format(site=site, service=service, instance=instance, contract="*")
