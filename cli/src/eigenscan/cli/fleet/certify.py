"""`eigenscan fleet certify`: a site's certificates and configuration, for robots, routers and services."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from eigenscan.runtime.errors import UsageError

if TYPE_CHECKING:
    from eigenscan.fleet.authority import Authority
    from eigenscan.fleet.layout import Fleet

LOCAL = ("localhost", "127.0.0.1", "::1")


def certify(
    site: Annotated[str | None, typer.Option(help="name of a new site, first chunk of every key")] = None,
    robot: Annotated[list[str] | None, typer.Option(help="robot to certify; as often as there are")] = None,
    address: Annotated[
        list[str] | None,
        typer.Option(help="host name or address of the site's router; robots connect to the first"),
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=3650, help="how long new certificates are valid")] = 730,
    folder: Annotated[Path, typer.Option("-o", "--fleet", help="the fleet's folder")] = Path("fleet"),
) -> None:
    """Make a site's certificates and configuration, or add robots to it.

    What is there already is kept: it makes what is missing. The authority's key signs certificates; keep it
    away from robots and servers. Private keys are for their owner only, and not encrypted. Groups of robots
    whose scans a projector elsewhere answers are named in fleet.toml.

    \b
    Examples:
      eigenscan fleet certify --site hospital --address 10.0.0.5 --robot r17 --robot r18 -o fleet
      eigenscan fleet certify --robot r19 -o fleet
    """  # noqa: D301 - \b keeps the lines apart in --help
    from eigenscan.fleet import layout
    from eigenscan.fleet.authority import Authority

    names, is_new = robot or [], not (folder / "fleet.toml").exists()
    fleet = _planned(folder, site, address or [], names)
    if is_new:
        Authority.create(fleet.site).save(folder / "authority")
        layout.begin(folder, fleet.site, fleet.addresses)
    authority = Authority.load(folder / "authority")
    _certify_site(authority, folder, fleet.addresses, days)
    for name in fleet.groups:
        if not (folder / "groups" / name / "projector.crt").exists():
            authority.issue(folder / "groups" / name, "projector", f"group.{name}", days)
    for name in names:
        authority.issue(folder / "robots" / name, "robot", f"robot.{name}", days)
    with layout.mended_by_configure(folder, "certificates are made, their configuration is not"):
        layout.configure(folder)
    typer.echo(f"{folder / 'authority'}: signs certificates; keep it away from robots and servers")
    needs = "" if (folder / "site/maps/map.yaml").exists() else "add your map as maps/map.yaml, and "
    typer.echo(f"{folder / 'site'}: {needs}copy it to {layout.INSTALLED} on the site's server")
    typer.echo(f"{folder / 'operator'}: copy it to {layout.INSTALLED} where the fleet is looked after")
    for name in fleet.groups:
        typer.echo(f"{folder / 'groups' / name}: copy it to {layout.INSTALLED} where its projector runs")
    for name in names:
        typer.echo(f"{folder / 'robots' / name}: copy it to {layout.INSTALLED} on {name}")
    for line in layout.left_out(folder):
        typer.echo(line, err=True)


def _planned(folder: Path, site: str | None, addresses: Sequence[str], names: Sequence[str]) -> Fleet:
    """The fleet that is there or is to be, with new robots. Raises UsageError before anything is written."""
    from eigenscan.fleet import layout

    settings = folder / "fleet.toml"
    if not settings.exists():
        if site is None or not addresses:
            raise UsageError(
                "a new fleet needs --site NAME and --address HOST, where robots reach its router"
            )
        wanted: dict[str, Any] = {"site": site, "addresses": addresses}
    elif site is not None or addresses:
        raise UsageError(f"--site, --address: {settings} has them; change them there")
    else:
        wanted = layout.in_force(folder).model_dump()
        layout.check(folder, names)
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"--robot {name}: is given twice: leave one out")
        if name in layout.robots(folder):
            raise UsageError(
                f"--robot {name}: has a certificate; for a new one: eigenscan fleet revoke {name} -o {folder}"
            )
    return layout.checked(wanted | {"robots": {name: {} for name in names}}, "--site, --address, --robot")


def _certify_site(authority: Authority, folder: Path, addresses: Sequence[str], days: int) -> None:
    """Certificates of the router and the site's services that have none."""
    from eigenscan.fleet import layout

    if not (folder / "site/router.crt").exists():
        authority.issue(folder / "site", "router", "site.router", days, serves=[*LOCAL, *addresses])
    for role, own in layout.services(folder).items():
        if not (own / f"{role.value}.crt").exists():
            authority.issue(own, role.value, f"site.{role.value}", days)
