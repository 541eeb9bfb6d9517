"""A user's choices for several services at once: a method, a file, and single settings, which win."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

from eigenscan.runtime.settings import (
    Given,
    ServiceSettings,
    SettingsError,
    gone,
    nearest,
    read_table,
    typed,
    validated,
)
from eigenscan.schemas.methods import METHODS, of_service
from pydantic import BaseModel

Core = TypeVar("Core", bound=BaseModel)

DEFAULT = "default"


@dataclass(frozen=True)
class Choices:
    """`method` of METHODS; `file` of the form of the services' own; `changes` by service, then by field."""

    method: str = DEFAULT
    file: Path | None = None
    changes: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @classmethod
    def of(cls, method: str, file: Path | None, changes: Iterable[str], services: Iterable[str]) -> Choices:
        """Choices as typed, `changes` as SERVICE.FIELD=VALUE of `services`.

        Raises SettingsError that names the unknown part and the known ones.
        """
        if method not in METHODS:
            raise SettingsError(f"--method {method}: unknown: choose one of {', '.join(METHODS)}")
        found: dict[str, dict[str, str]] = {}
        for text in changes:
            place, equals, value = text.partition("=")
            service, dot, name = place.partition(".")
            if not (equals and dot and name):
                raise SettingsError(
                    f"--set {text}: give SERVICE.SETTING=VALUE, such as tracker.localized_above=0.95"
                )
            if service not in services:
                meant = nearest(service, services) or f": choose one of {', '.join(services)}"
                raise SettingsError(f"--set {text}: {service}: unknown{meant}")
            found.setdefault(service, {})[name] = value
        return cls(method, file, found)

    def core(self, options: type[ServiceSettings], core: type[Core], service: str) -> Core:
        """Settings of a service's core alone, without the environment, where no process runs.

        The file's options of the process are ignored. Raises SettingsError that names place, field and fix.
        """
        given = self._given(options, service, core.model_fields)
        return validated(core, {name: each for name, each in given.items() if name in core.model_fields})

    def flags(self, options: type[ServiceSettings], service: str) -> list[str]:
        """These choices as flags of a service's process. Raises SettingsError before it starts."""
        given = self._given(options, service, options.model_fields)
        own = [kind for kind in options.__mro__ if issubclass(kind, BaseModel) and kind is not BaseModel]
        core = next((kind for kind in own if not issubclass(kind, ServiceSettings)), None)
        if core is not None:
            validated(core, {name: each for name, each in given.items() if name in core.model_fields})
        flags = [] if self.file is None else ["--config", str(self.file)]
        for name, each in given.items():
            if self.file is None or not each.place.startswith(f"{self.file}:"):
                flags.append(f"--{name.replace('_', '-')}={_text(each.value)}")  # a value may begin with -
        return flags

    def _given(
        self, options: type[ServiceSettings], service: str, changeable: Iterable[str]
    ) -> dict[str, Given]:
        """The chosen value of each field: from a single change, else the file, else the method."""
        given = {
            name: Given(value, f"--method {self.method}: {service}.{name}")
            for name, value in of_service(self.method, service).items()
        }
        if self.file is not None:
            given |= read_table(options, service, self.file, "--settings")
        known = list(changeable)
        for name, text in self.changes.get(service, {}).items():
            if name not in known:
                meant = nearest(name, known) or ": docs/settings.md has them all"
                raise SettingsError(f"--set {service}.{name}: {gone(options, name) or f'unknown{meant}'}")
            given[name] = Given(typed(options, name, text), f"--set {service}.{name}")
        return given


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)
