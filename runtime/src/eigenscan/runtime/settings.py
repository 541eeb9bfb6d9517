"""Typed settings from flags, environment and a TOML file, in this order of precedence.

A service's settings derive from ServiceSettings. Environment names are `EIGENSCAN_` and the field's
name in capitals, or `EIGENSCAN_<SERVICE>_<FIELD>` for one service only. In the file, top-level keys
hold for all services and the table `[<service>]` for one.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tomllib
from pathlib import Path
from typing import Any, TypeVar

from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE
from pydantic import BaseModel, ConfigDict, Field, ValidationError

S = TypeVar("S", bound="ServiceSettings")


class SettingsError(ValueError):
    """Settings that do not hold; the message names the source, the field and the fix."""


class ServiceSettings(BaseModel):
    """What every service can be told."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    site: str = Field(DEFAULT_SITE, description="site name, first chunk of every key")
    robot: str = Field(DEFAULT_ROBOT, description="robot to serve; * serves every robot of the site")
    instance: str = Field("0", description="name of this instance among those of its service")
    zenoh: Path | None = Field(None, description="Zenoh configuration, JSON5; without it an embedded peer")
    metrics_port: int | None = Field(
        None,
        ge=0,
        le=65535,
        description="serve /metrics and /healthz on this port; 0 chooses one; off without it",
    )
    metrics_host: str = Field("127.0.0.1", description="address that the metrics are served on")
    log_level: str = Field(
        "info", pattern="^(debug|info|warning|error)$", description="debug, info, warning or error"
    )
    log_format: str = Field(
        "auto",
        pattern="^(auto|json|console)$",
        description="json, console, or auto: console on a terminal",
    )


def load(kind: type[S], service: str, arguments: list[str] | None = None) -> S:
    """Settings of `service` from `arguments` (default: the command line), environment and file.

    Raises SettingsError naming source, field and what would be accepted. `--help` prints and exits.
    """
    flags = _flags(kind, service, sys.argv[1:] if arguments is None else arguments)
    config = flags.pop("config", None) or os.environ.get("EIGENSCAN_CONFIG")
    layers = [
        _file(kind, service, Path(config)) if config else {},
        _environment(kind, service),
        flags,
    ]
    values: dict[str, Any] = {}
    sources: dict[str, str] = {}
    names = [f"{config}", "environment", "flags"]
    for layer, source in zip(layers, names, strict=True):
        values.update(layer)
        sources.update(dict.fromkeys(layer, source))
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        raise SettingsError(_explain(error, sources)) from error


def _explain(error: ValidationError, sources: dict[str, str]) -> str:
    lines = []
    for problem in error.errors():
        field = ".".join(str(part) for part in problem["loc"])
        source = sources.get(str(problem["loc"][0]) if problem["loc"] else "", "settings")
        lines.append(f"{source}: {field} = {problem['input']!r}: {problem['msg']}")
    return "; ".join(lines)


def _flags(kind: type[ServiceSettings], service: str, arguments: list[str]) -> dict[str, Any]:
    parser = argparse.ArgumentParser(
        prog=f"eigenscan-{service}",
        description=(kind.__doc__ or "").strip(),
        epilog=f"example: eigenscan-{service} --site hospital --robot r17 --metrics-port 9100",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--config", help="TOML file; flags and environment win over it", default=None)
    for name, field in kind.model_fields.items():
        parser.add_argument(
            f"--{name.replace('_', '-')}",
            dest=name,
            default=argparse.SUPPRESS,
            metavar="VALUE",
            help=f"{field.description or name} (default: {field.get_default(call_default_factory=True)})",
        )
    given = vars(parser.parse_args(arguments))
    return {
        name: value if name == "config" else _typed(kind, name, value)
        for name, value in given.items()
        if value is not None
    }


def _environment(kind: type[ServiceSettings], service: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in kind.model_fields:
        for variable in (
            f"EIGENSCAN_{name.upper()}",
            f"EIGENSCAN_{service.replace('-', '_').upper()}_{name.upper()}",
        ):
            if variable in os.environ:
                found[name] = _typed(kind, name, os.environ[variable])
    return found


def _typed(kind: type[ServiceSettings], name: str, text: str) -> Any:
    """Lists and tables are given as JSON; all else stays text, which pydantic converts."""
    annotation = str(kind.model_fields[name].annotation)
    if text[:1] in "[{" and not annotation.startswith("<class 'str'"):
        try:
            return json.loads(text)
        except json.JSONDecodeError:
            return text
    return text


def _file(kind: type[ServiceSettings], service: str, path: Path) -> dict[str, Any]:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror}): check --config") from error
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from error
    common = {
        name: value
        for name, value in content.items()
        if not isinstance(value, dict) and name in kind.model_fields
    }
    own = content.get(service, {})
    if not isinstance(own, dict):
        raise SettingsError(f"{path}: {service} must be a table, [{service}]")
    return common | own
