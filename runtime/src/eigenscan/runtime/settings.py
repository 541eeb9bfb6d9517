"""Typed settings from flags, environment and a TOML file, in this order of precedence.

A service's settings derive from ServiceSettings. The environment variable of a field is `EIGENSCAN_<FIELD>`,
or `EIGENSCAN_<SERVICE>_<FIELD>` for one service only, which wins. An empty variable counts as not set. In the
file, top-level keys apply to all services, and the table `[<service>]` to one. Flags and variables take lists
and tables as JSON.
"""

from __future__ import annotations

import argparse
import difflib
import itertools
import json
import os
import sys
import tomllib
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from eigenscan.runtime.printable import shortened
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, is_chunk
from eigenscan.schemas.group import EVERY, chunk_of, instance_name, patterns
from eigenscan.schemas.settings import Settings
from pydantic import BaseModel, ConfigDict, Field, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails

S = TypeVar("S", bound="ServiceSettings")
M = TypeVar("M", bound=BaseModel)

LAST_PORT = 65535

NO_PATH = "must not be empty: give a path, or leave it out"

_SERVED = frozenset(("site", "robot", "instance"))
"""Settings that form the keys of a service's core."""


MOST_SHOWN = 200
"""Characters of a bad value that an error quotes."""
MOST_DOTS = 500
"""Most dots on one line of a TOML file, enough for a hundred addresses."""
MOST_TABLE_BYTES = 40_000
"""Largest settings file: several times the size of one with every setting of all services."""


class SettingsError(ValueError):
    """Invalid settings; the message names the source, the field and the fix."""


class ServiceSettings(Settings):
    """Settings that every service has: how its process runs.

    A service's options derive from this class and from its core's settings, which change its answers.
    """

    model_config = ConfigDict(ser_json_inf_nan="strings")

    site: str = Field(DEFAULT_SITE, description="name of the site; the first part of every key")
    robot: str = Field(
        DEFAULT_ROBOT,
        description="robots to serve: names and patterns with commas, such as a-*,b-7; * is all",
    )
    instance: str = Field(
        default_factory=lambda given: instance_name(given.get("robot", EVERY)),
        description="name of this process among those of the same service; default: the robot's name",
    )
    zenoh: Path | None = Field(
        None,
        description="Zenoh configuration file, JSON5; default: this machine only",
    )
    keep: Path | None = Field(
        None,
        description="folder that caches maps and models, for a start without the site",
    )
    metrics_port: int | None = Field(
        None,
        ge=0,
        le=LAST_PORT,
        description="port for /metrics and /healthz; 0 takes a free one; default: none",
    )
    metrics_host: str = Field("127.0.0.1", description="address for /metrics and /healthz")
    behind_after: float = Field(
        1.0,
        ge=0,
        description="seconds of backlog after which only the newest scan of each lidar is processed; inf "
        "disables",
    )
    log_level: str = Field(
        "info", pattern="^(debug|info|warning|error)$", description="debug, info, warning or error"
    )
    log_format: str = Field(
        "auto",
        pattern="^(auto|json|console)$",
        description="json or console; auto is console on a terminal, else json",
    )
    stop_s: float = Field(
        2.0,
        gt=0.0,
        le=86_400.0,
        description="seconds that the service may take to stop; give more on a very busy machine or disk",
    )

    deaf_after: int = Field(
        20,
        ge=0,
        description="seconds without any message of the other services of this instance name, although they "
        "are alive, after which the process ends with exit code 75, to be restarted; 0 disables",
    )

    @classmethod
    def answering(cls) -> frozenset[str]:
        """Names of the settings that may change an answer: the core's, and the robots that it serves."""
        cores = [kind for kind in cls.__mro__ if issubclass(kind, BaseModel)]
        own = [kind.model_fields for kind in cores if not issubclass(kind, ServiceSettings)]
        return _SERVED.union(*own)

    def answering_json(self) -> str:
        """What the core's answers may depend on, as JSON."""
        return self.model_dump_json(include=set(self.answering()))

    @field_validator("*", mode="before")
    @classmethod
    def _no_empty_path(cls, value: Any, info: ValidationInfo) -> Any:
        """Refuses a path of no characters: it would mean the working folder."""
        if value == "" and _is_path(cls.model_fields[str(info.field_name)].annotation):
            raise ValueError(NO_PATH)
        return value

    @field_validator("site", "instance")
    @classmethod
    def _one_chunk(cls, value: str) -> str:
        if not is_chunk(value):
            raise ValueError("must be one chunk of a key: not empty, no blanks, none of / * $ # ? @")
        return value

    @field_validator("robot")
    @classmethod
    def _each_robot_once(cls, value: str) -> str:
        """Refuses two patterns that fit the same robot: the service would receive each message twice."""
        pairs = list(itertools.combinations(patterns(value), 2))
        if pairs:
            from zenoh import KeyExpr

            for one, other in pairs:
                if KeyExpr(chunk_of(one)).intersects(chunk_of(other)):
                    raise ValueError(f"{one} and {other} fit the same robots: name each robot once")
        return value


@dataclass(frozen=True)
class Given:
    """A value as the user wrote it, and where: a flag, a variable, or a file and key."""

    value: Any
    place: str


def load(kind: type[S], service: str, arguments: list[str] | None = None) -> S:
    """Settings of `service` from `arguments` (default: the command line), the environment and the file.

    Raises SettingsError that names the source, the field and what is accepted. `--help` prints and exits.
    """
    flags = _flags(kind, service, sys.argv[1:] if arguments is None else arguments)
    config = flags.pop("config", None)
    if config and not config.value:
        raise SettingsError(f"--config = '': {NO_PATH}")
    path = config.value if config else os.environ.get("EIGENSCAN_CONFIG")
    given = read_table(kind, service, Path(path)) if path else {}
    return validated(kind, given | _environment(kind, service) | flags)


def validated(kind: type[M], given: Mapping[str, Given]) -> M:
    """Checks values by `kind`. Raises SettingsError that names the source, the field and what is accepted."""
    values = {name: entry.value for name, entry in given.items()}
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        # a default that derives from a bad value fails too: report only the bad value
        faults = [each for each in error.errors() if each["type"] != "default_factory_not_called"]
        raise SettingsError("; ".join(_explain(fault, given) for fault in faults)) from error


def _explain(problem: ErrorDetails, given: Mapping[str, Given]) -> str:
    if not problem["loc"]:  # of several settings together
        return shortened(plain(problem["msg"]), MOST_SHOWN)
    field, *inner = [str(part) for part in problem["loc"]]
    return explained(problem, ".".join([given[field].place if field in given else field, *inner]))


def explained(problem: ErrorDetails, place: str) -> str:
    """A fault that pydantic found at a place, in our words."""
    if words := {"missing": "must be given", "extra_forbidden": "unknown"}.get(problem["type"]):
        return f"{place}: {words}"
    message = plain(problem["msg"])
    if problem["type"] in {"list_type", "dict_type", "tuple_type", "set_type"}:
        message += ', written as JSON such as ["a", "b"]'
    return f"{place} = {repr(problem['input'])[:MOST_SHOWN]}: {shortened(message, MOST_SHOWN)}"


def plain(message: str) -> str:
    """Pydantic's message in our words."""
    text = message.removeprefix("Value error, ").replace("Input should be", "must be")
    return text.partition(", unable to parse")[0]


class _Parser(argparse.ArgumentParser):
    """Reports a mistake in one line, where argparse prints all options first."""

    def error(self, message: str) -> typing.NoReturn:
        raise SettingsError(f"{message}: see {self.prog} --help")


def _flags(kind: type[ServiceSettings], service: str, arguments: list[str]) -> dict[str, Given]:
    parser = _Parser(
        prog=f"eigenscan-{service}",
        description=(kind.__doc__ or "").strip(),
        epilog=f"example: eigenscan-{service} --site hospital --robot r17 --metrics-port 9100",
        allow_abbrev=False,
    )
    parser.add_argument("--config", metavar="FILE", help="TOML file; flags and environment win over it")
    for name, field in kind.model_fields.items():
        default = "" if field.default_factory or field.is_required() else f" (default: {field.default})"
        parser.add_argument(
            _flag(name),
            dest=name,
            metavar="VALUE",
            help=f"{field.description or name}{default}".replace("%", "%%"),
            nargs="?" if field.annotation is bool else None,
            const="true" if field.annotation is bool else None,
        )
    for given in arguments:
        if hint := gone(kind, given.partition("=")[0].removeprefix("--").replace("-", "_")):
            raise SettingsError(f"{given.partition('=')[0]}: {hint}")
    values, unknown = parser.parse_known_args(arguments)
    if unknown:
        name = unknown[0].partition("=")[0]
        hint = nearest(name, ["--config", *map(_flag, kind.model_fields)])
        raise SettingsError(f"{name}: no such option{hint}: see {parser.prog} --help")
    return {
        name: Given(typed(kind, name, value), _flag(name))
        for name, value in vars(values).items()
        if value is not None
    }


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def _environment(kind: type[ServiceSettings], service: str) -> dict[str, Given]:
    own = f"EIGENSCAN_{service.replace('-', '_').upper()}_"
    names = {name.upper(): name for name in kind.model_fields}
    found = {}
    for prefix in ("EIGENSCAN_", own):
        for capitals, name in names.items():
            if text := os.environ.get(prefix + capitals):
                found[name] = Given(typed(kind, name, text), f"environment: {prefix}{capitals}")
    for variable in filter(lambda each: each.startswith("EIGENSCAN_"), os.environ):
        rest = variable.removeprefix(own)
        if variable.startswith(own) and rest not in names:
            hint = gone(kind, rest.lower()) or f"unknown{nearest(rest, names, own)}"
            raise SettingsError(f"environment: {variable}: {hint}")
        for capitals in () if variable.startswith(own) else names:
            stem = variable.removesuffix(capitals)
            if stem not in (variable, "EIGENSCAN_") and difflib.get_close_matches(stem, [own], cutoff=0.9):
                raise SettingsError(f"environment: {variable}: unknown, did you mean {own}{capitals}?")
        if meant := _misspelt(variable.removeprefix("EIGENSCAN_")):
            raise SettingsError(f"environment: {variable}: unknown, did you mean EIGENSCAN_{meant}?")
    return found


def _misspelt(name: str) -> str:
    """The shared setting that a variable seems to mean; empty: it may be another program's or service's."""
    shared = ["CONFIG", *map(str.upper, ServiceSettings.model_fields)]
    alike = [each for each in shared if sorted(each) == sorted(name)]
    near = [*difflib.get_close_matches(name, shared, n=1, cutoff=0.8), *alike]
    return near[0] if near and name not in shared else ""


def typed(kind: type[ServiceSettings], name: str, text: str) -> Any:
    """`text` for pydantic: parsed as JSON if the field is a list or a table."""
    annotation = kind.model_fields.get(name)
    if annotation is None or _is_plain(annotation.annotation):
        return text
    try:
        return json.loads(text)
    except (ValueError, RecursionError):  # not JSON, or hostile JSON
        return text


def _is_path(annotation: Any) -> bool:
    return Path in (annotation, *typing.get_args(annotation))


def _is_plain(annotation: Any) -> bool:
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return all(_is_plain(one) for one in typing.get_args(annotation))
    return typing.get_origin(annotation) is typing.Literal or (
        isinstance(annotation, type) and not issubclass(annotation, (list, tuple, dict, set, BaseModel))
    )


def read_table(
    kind: type[ServiceSettings], service: str, path: Path, asked: str = "--config"
) -> dict[str, Given]:
    """A service's settings in a TOML file that `asked` names. Raises SettingsError."""
    try:
        if path.stat().st_size > MOST_TABLE_BYTES:
            raise SettingsError(f"{path}: has more than {MOST_TABLE_BYTES} bytes: check {asked}")
        content = parse_toml(path.read_bytes())
    except SettingsError:
        raise
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror}): check {asked}") from error
    except (ValueError, RecursionError) as error:
        raise SettingsError(f"{path}: is not TOML: {error}") from error
    tables = {name: value for name, value in content.items() if isinstance(value, dict)}
    shared = {name: value for name, value in content.items() if name not in tables}
    own = tables.get(service, {})
    if service in shared:
        raise SettingsError(f"{path}: {service}: must be a table, [{service}]")
    for name in tables:
        if name != service and difflib.get_close_matches(name, [service], cutoff=0.85):
            raise SettingsError(f"{path}: [{name}]: unknown, did you mean [{service}]?")
    for place, values, known in (
        ("", shared, ServiceSettings.model_fields),
        (f"[{service}] ", own, kind.model_fields),
    ):
        for name in values:
            if name not in known:
                hint = (
                    f", is it for [{service}]?"
                    if name in kind.model_fields
                    else nearest(name, known) or ": docs/settings.md has every service's settings"
                )
                raise SettingsError(f"{path}: {place}{name}: {gone(kind, name) or f'unknown{hint}'}")
    return {name: Given(value, f"{path}: {name}") for name, value in shared.items()} | {
        name: Given(value, f"{path}: [{service}] {name}") for name, value in own.items()
    }


def parse_toml(content: bytes) -> dict[str, Any]:
    """The content of a TOML file. Raises ValueError or RecursionError if it is not TOML.

    The parser's time grows with the square of a key's parts, so a line with very many dots is refused.
    """
    try:
        text = content.decode("utf-8-sig")  # some editors put a byte order mark first
    except UnicodeDecodeError as error:
        raise ValueError(f"byte {error.start} is not UTF-8: save the file as UTF-8") from error
    if any(line.count(".") > MOST_DOTS for line in text.splitlines()):
        raise ValueError(f"a line with more than {MOST_DOTS} dots")
    return tomllib.loads(text)


def gone(kind: type[BaseModel], name: str) -> str:
    """For a removed setting, an explanation of what replaced it; empty for any other name."""
    replaced: typing.Mapping[str, str] = getattr(kind, "gone", {})
    return f"was removed: {replaced[name]}" if name in replaced else ""


def nearest(name: str, known: typing.Iterable[str], prefix: str = "") -> str:
    """A hint for an unknown name: the most similar known one, or nothing."""
    near = difflib.get_close_matches(name, list(known), n=1, cutoff=0.7)
    return f", did you mean {prefix}{near[0]}?" if near else ""
