"""A fleet's folder: what is on which machine, and what the fleet's owner wants of it.

fleet.toml       site, the router's addresses, what crosses the air: for its owner to edit
authority/       the key that signs certificates: on no server, on no robot
site/            /etc/eigenscan of the site's server
robots/NAME/     /etc/eigenscan of one robot
groups/NAME/     /etc/eigenscan of a machine whose projector serves several robots
revoked/         certificates that are shut out
"""

from __future__ import annotations

import itertools
import json
import math
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any

from eigenscan.fleet import access, configuration
from eigenscan.fleet.access import Air
from eigenscan.fleet.authority import LONGEST_NAME, common_name, is_for, write_whole
from eigenscan.fleet.configuration import INSTALLED
from eigenscan.runtime.errors import FailedError, UsageError, one_line
from eigenscan.runtime.settings import explained, parse_toml
from eigenscan.schemas.channels import CHANNELS, SCAN, Role, by_name, is_chunk
from eigenscan.schemas.group import chunk_of, holds, patterns
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails

__all__ = [
    "INSTALLED",
    "begin",
    "check",
    "checked",
    "configure",
    "in_force",
    "left_out",
    "mended_by_configure",
    "read",
    "revoke",
    "robots",
    "services",
]

HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9.-]{0,251}[A-Za-z0-9])?")

TEMPLATE = """\
# A fleet of robots on one site. After a change: eigenscan fleet configure -o THIS FOLDER
site = {site}
addresses = {addresses}  # of the site's router; robots connect to the first
# The site's router accepts a robot's messages at ten times its rate at most. On a bad link they come in
# bursts, of which only the first passes. false: all pass, also those of a robot that floods the site.
hold_back_floods = true

# Robots whose scans a projector elsewhere answers, by its name; certify makes its certificate. Their scans
# cross the air.
[groups]
# lab = "a-*,b-7"

# Samples a second that a robot may send to the site, in place of the contract's; 0: none,
# 1000 at most.
# Of all keys of the channel together, so of all lidars.
[air]
scan = 2.0  # the mapbuilder needs them to keep the map true


# [robots.r17]  # for one robot only
# scan_raw = 5.0
"""


def _channel(name: str) -> str:
    channel = by_name(name)
    if Role.ROBOT not in channel.published_by:
        raise ValueError(f"{name} does not come from robots")
    return name


def _chunk(name: str) -> str:
    if not is_chunk(name):
        raise ValueError("must be one chunk of a key: not empty, no blanks, none of / * $ # ? @")
    return name


def _within(most: int) -> AfterValidator:
    """Of names of at most so many bytes, for a certificate's common name."""

    def check(name: str) -> str:
        if len(name.encode()) > most:
            raise ValueError(f"is too long for a certificate: shorten it to {most} bytes")
        return name

    return AfterValidator(check)


def _robot(name: str) -> str:
    # "site": the instance of the site's own services, for whose keys such a robot would have rights
    if {".", ","} & {*_chunk(name)} or name in {"site", *(role.value for role in Role)}:
        raise ValueError(
            "a robot's name has no dot and no comma, and is not site or that of a service of the site"
        )
    return name


def _group(robots: str) -> str:
    patterns(robots)
    return robots


def _host(name: str) -> str:
    try:
        address = ip_address(name)
    except ValueError:
        if not HOST_NAME.fullmatch(name):
            raise ValueError("must be a host name or an IP address, without a port") from None
        return name
    if getattr(address, "scope_id", None):
        raise ValueError("a zone such as %eth0 holds on one machine only: give an address without one")
    return name


Hertz = Annotated[float, Field(ge=0.0, le=1000.0, strict=True)]  # strict: true is no number
Rates = dict[Annotated[str, AfterValidator(_channel)], Hertz]
HolderName = Annotated[str, AfterValidator(_robot), _within(LONGEST_NAME - len("robot..01234567"))]
"""Of a robot or a group; behind it a common name has a random part."""


class Fleet(BaseModel):
    """The content of fleet.toml."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    site: Annotated[str, AfterValidator(_chunk), _within(LONGEST_NAME - len(" fleet"))]
    addresses: Annotated[tuple[Annotated[str, AfterValidator(_host)], ...], Field(min_length=1)]
    hold_back_floods: bool = True
    groups: dict[HolderName, Annotated[str, AfterValidator(_group)]] = {}
    air: Rates = {}
    robots: dict[HolderName, Rates] = {}

    def air_of(self, robot: str) -> Air:
        """Samples a second of each channel that this robot may send over the air."""
        usual = {one.name: one.qos.air_hz for one in CHANNELS} | self.air
        if any(holds(group, robot) for group in self.groups.values()):
            usual[SCAN.name] = math.inf  # an answering projector needs all scans, whatever others send
        return usual | self.robots.get(robot, {})


def read(folder: Path) -> Fleet:
    """fleet.toml of `folder`. Raises UsageError naming the file, the field and the fix."""
    path = folder / "fleet.toml"
    if not path.exists():
        raise UsageError(
            f"{path}: is not there: make a fleet with eigenscan fleet certify --site NAME -o {folder}"
        )
    return checked(_toml(path), str(path))


def _toml(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{path}: is not TOML: {error}") from error


def checked(content: Mapping[str, Any], source: str) -> Fleet:
    """Checks `content`. Raises UsageError that names `source`, the field and what is accepted."""
    try:
        return Fleet.model_validate(content)
    except ValidationError as error:
        all_faults = error.errors()
        faults = "; ".join(
            explained(fault, _place(fault)) for fault in all_faults if not _is_of_its_parts(fault, all_faults)
        )
        raise UsageError(f"{source}: {faults}") from error


def _is_of_its_parts(fault: ErrorDetails, faults: Sequence[ErrorDetails]) -> bool:
    """Whether a list is refused because each of its parts is: only those are of interest."""
    here = fault["loc"]
    return any(len(other["loc"]) > len(here) and other["loc"][: len(here)] == here for other in faults)


def _place(fault: ErrorDetails) -> str:
    return ".".join(map(str, fault["loc"])).removesuffix(".[key]")


def begin(folder: Path, site: str, addresses: Sequence[str]) -> None:
    """Writes fleet.toml of a new fleet."""
    quoted = json.dumps(site, ensure_ascii=False)  # TOML has no surrogates
    text = TEMPLATE.format(site=quoted, addresses=json.dumps(list(addresses)))
    _begin(folder / "fleet.toml", text)


def robots(folder: Path) -> tuple[str, ...]:
    """Names of the robots that hold a certificate."""
    return tuple(sorted(path.parent.name for path in (folder / "robots").glob("*/robot.crt")))


def in_force(folder: Path) -> Fleet:
    """fleet.toml without the robots and groups whose certificates are revoked. Raises as `read` does."""
    fleet = read(folder)
    robots = {name: air for name, air in fleet.robots.items() if not _revoked(folder, "robot", name)}
    groups = {name: group for name, group in fleet.groups.items() if not _revoked(folder, "group", name)}
    return fleet.model_copy(update={"robots": robots, "groups": groups})


def left_out(folder: Path) -> list[str]:
    """A line on each part of fleet.toml that is not in force, and what its owner must do."""
    path, whole, part = folder / "fleet.toml", read(folder), in_force(folder)
    lines = [
        f"{path}: robots.{name}: is left out, for its certificate is revoked: delete the table"
        for name in sorted(set(whole.robots) - set(part.robots))
    ]
    for name in sorted(set(whole.groups) - set(part.groups)):
        old = ", ".join(map(str, _revoked(folder, "group", name)))
        lines.append(
            f"{path}: groups.{name}: is left out, for its certificate is revoked: delete the line; or, for a "
            f"new certificate, delete {old} and run: eigenscan fleet certify -o {folder}"
        )
    return lines


def _certified_groups(folder: Path) -> set[str]:
    return {path.parent.name for path in (folder / "groups").glob("*/projector.crt")}


def _revoked(folder: Path, kind: str, name: str) -> list[Path]:
    """Revoked certificates of a robot or group that holds no other."""
    held = {"robot": f"robots/{name}/robot.crt", "group": f"groups/{name}/projector.crt"}[kind]
    all_revoked = [] if (folder / held).exists() else sorted((folder / "revoked").glob("*.crt"))
    return [path for path in all_revoked if path.stem.rpartition(".")[0] == f"{kind}.{name}"]


def services(folder: Path) -> dict[Role, Path]:
    """Roles that hold a certificate besides routers and robots, and the folder of each."""
    return {
        role: folder / ("operator" if role is Role.OPERATOR else "site")
        for role in Role
        if role is not Role.ROBOT
    }


def check(folder: Path, names: Sequence[str] = ()) -> None:
    """Checks fleet.toml with robots `names` more, and what was made of a former one. Raises UsageError."""
    _check_groups(folder, names)
    fleet, settings, router = read(folder), folder / "fleet.toml", folder / "site/router.crt"
    strange = [one for one in fleet.addresses if router.exists() and not is_for(router, one)]
    if strange:
        raise UsageError(
            f"{settings}: addresses: robots refuse {strange[0]}, for which {router} is not: delete it and "
            f"router.key, then run: eigenscan fleet certify -o {folder}"
        )
    for path in sorted(folder.rglob("eigenscan.toml")):
        site = _toml(path).get("site", fleet.site)
        if site != fleet.site:
            raise UsageError(
                f"{path}: site = {site!r}, and {settings} has {fleet.site!r}: change one of them"
            )


def _check_groups(folder: Path, names: Sequence[str] = ()) -> None:
    """Raises UsageError where a group has the name of a robot, of `names` too, or two groups a robot."""
    from zenoh import KeyExpr

    settings = folder / "fleet.toml"
    # also a revoked group's: its robot could not be revoked
    if both := sorted({*names, *robots(folder)} & read(folder).groups.keys()):
        raise UsageError(f"{settings}: groups.{both[0]}: is a robot's name as well: choose another")
    for (one, its), (other, theirs) in itertools.combinations(in_force(folder).groups.items(), 2):
        for each, another in itertools.product(patterns(its), patterns(theirs)):
            if KeyExpr(chunk_of(each)).intersects(chunk_of(another)):
                raise UsageError(
                    f"{settings}: groups.{one} and groups.{other}: {each} and {another} fit the same robots: "
                    "let each robot be in one group"
                )


def configure(folder: Path) -> None:
    """Writes the configuration of every router and service of the fleet. Raises UsageError."""
    check(folder)
    if uncertified := sorted(in_force(folder).groups.keys() - _certified_groups(folder)):
        raise UsageError(
            f"{folder / 'fleet.toml'}: groups.{uncertified[0]}: has no certificate: run: "
            f"eigenscan fleet certify -o {folder}"
        )
    _configure(folder)


def _configure(folder: Path) -> None:
    """The same of groups as they are: a fault in them must keep nobody in who is shut out."""
    fleet, members = in_force(folder), robots(folder)
    held = {name: group for name, group in fleet.groups.items() if name in _certified_groups(folder)}
    fleet = fleet.model_copy(update={"groups": held})
    if unknown := sorted(set(fleet.robots) - set(members)):
        known = ", ".join(members)
        raise UsageError(
            f"{folder / 'fleet.toml'}: robots.{unknown[0]}: has no certificate; choose one of {known}"
        )
    certified = {role: own for role, own in services(folder).items() if (own / f"{role.value}.crt").exists()}
    for role, own in certified.items():
        is_operator = role is Role.OPERATOR
        router, missed = (fleet.addresses[0], members) if is_operator else ("localhost", ())
        _write(own / f"{role.value}.json5", configuration.site_service(role.value, router, missed))
    groups = {
        name: (common_name(folder / "groups" / name / "projector.crt"), group)
        for name, group in fleet.groups.items()
    }
    for name, (_, group) in groups.items():
        own = folder / "groups" / name
        _write(own / "projector.json5", configuration.site_service("projector", fleet.addresses[0]))
        _begin(own / "eigenscan.toml", configuration.group_settings(fleet.site, name, group))
    for name in members:
        own, served = folder / "robots" / name, access.is_served(name, groups)
        _write(
            own / "router.json5",
            configuration.robot_router(
                fleet.site, name, fleet.air_of(name), fleet.addresses[0], served=served
            ),
        )
        _write(own / "service.json5", configuration.robot_service())
        _begin(own / "eigenscan.toml", configuration.settings(fleet.site, name))
    _begin(folder / "site" / "eigenscan.toml", configuration.settings(fleet.site))
    _write(
        folder / "site" / "router.json5",
        configuration.site_router(
            fleet.site,
            {
                name: (common_name(folder / "robots" / name / "robot.crt"), fleet.air_of(name))
                for name in members
            },
            {role: common_name(own / f"{role.value}.crt") for role, own in certified.items()},
            groups,
            fleet.hold_back_floods,
        ),
    )


def revoke(folder: Path, name: str) -> Path:
    """Revokes the certificate of a robot or a service of the site; returns its new place.

    The local copy of its private key is deleted. Raises UsageError if `name` has no certificate.
    """
    groups = read(folder).groups  # refuses a folder that is no fleet
    of_service = {role.value: own / f"{role.value}.crt" for role, own in services(folder).items()}
    of_service |= {each: folder / "groups" / each / "projector.crt" for each in groups}
    of_service = {each: path for each, path in of_service.items() if path.exists()}
    held = of_service.get(name, folder / "robots" / name / "robot.crt")
    if not held.exists():
        known = ", ".join([*robots(folder), *of_service])
        raise UsageError(f"{name}: has no certificate; choose one of {known}")
    try:
        whose = common_name(held)
    except UsageError:  # damaged: whom the router admits is listed, so it goes all the same
        kind = "group" if name in groups else "site" if name in of_service else "robot"
        whose = f"{kind}.{name}.damaged"
    kept = folder / "revoked" / f"{whose}.crt"
    kept.parent.mkdir(exist_ok=True)
    held.rename(kept)
    with mended_by_configure(folder, f"{name} is NOT shut out yet"):
        held.with_suffix(".key").unlink(missing_ok=True)
        if name in of_service:
            held.with_suffix(".json5").unlink(missing_ok=True)
        else:
            _clear(held.parent, configuration.settings(read(folder).site, name))
        _configure(folder)
    return kept


def _clear(own: Path, begun: str) -> None:
    """Deletes a robot's folder, but keeps the settings that its owner edited: not those `begun`."""
    settings = own / "eigenscan.toml"
    if not settings.exists() or settings.read_text(encoding="utf-8") == begun:
        shutil.rmtree(own)
        return
    for path in own.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path != settings:
            path.unlink()


@contextmanager
def mended_by_configure(folder: Path, otherwise: str) -> Iterator[None]:
    """After a change of certificates: a full disk or a fault in fleet.toml leaves `configure` to be done."""
    try:
        yield
    except (OSError, UsageError) as error:
        raise FailedError(
            f"{otherwise}: {one_line(error)}; then run: eigenscan fleet configure -o {folder}"
        ) from error


def _begin(path: Path, content: str) -> None:
    """Writes a file that its owner may edit later."""
    if not path.exists():
        path.write_text(content, encoding="utf-8")


def _write(path: Path, content: dict[str, Any]) -> None:
    """Writes in one step, so a router never reads half a file."""
    write_whole(path, f"{json.dumps(content, indent=2, ensure_ascii=False)}\n".encode())
