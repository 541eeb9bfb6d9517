"""The instances that a recording received, as cores with the settings they had."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.printable import printable
from eigenscan.runtime.settings import ServiceSettings, explained, nearest
from eigenscan.schemas.channels import Channel
from eigenscan.schemas.envelope import Condition, Core, Envelope
from eigenscan.schemas.group import EVERY, holds
from eigenscan.workbench.replay.services import Service
from eigenscan.workbench.replay.survey import Survey
from pydantic import ValidationError

Changes = Mapping[str, Mapping[str, str]]
"""Settings to replay with instead: values as text, by service and setting."""


@dataclass
class Instance:
    """A core in a replay: it receives its process's inputs, and an error does not end the replay."""

    service: Service
    name: str
    robots: str
    """The group that it serves."""
    source: str
    """Source of its settings, as text."""
    core: Core
    settings: str
    """That it runs with, JSON."""
    faults: list[str] = field(default_factory=list)
    first_error: Exception | None = None
    inputs: tuple[Channel, ...] = field(init=False)
    outputs: tuple[Channel, ...] = field(init=False)

    def __post_init__(self) -> None:
        self.inputs, self.outputs = self.core.inputs, self.core.outputs

    def start(self) -> Iterable[Envelope]:
        """As its core."""
        return self.core.start()

    def handle(self, received: Envelope) -> Iterable[Envelope]:
        """The core's answers until it fails; none for other robots."""
        if "robot" in received.address and not holds(self.robots, received.address["robot"]):
            return
        try:
            yield from self.core.handle(received)
        except Exception as error:
            self.first_error = self.first_error or error
            self.faults.append(f"{type(error).__name__} on {received.key}: {error}")

    @property
    def failure(self) -> str:
        """On how many messages its core failed, and the first error; empty: on none."""
        if not self.faults:
            return ""
        name = f"{self.service.name} {self.name}"
        return f"{name} failed on {len(self.faults)} messages; first, {self.faults[0]}"

    def finish(self) -> Iterable[Envelope]:
        """As its core."""
        return self.core.finish()

    def condition(self) -> Condition:
        """As its core."""
        return self.core.condition()


def cast(survey: Survey, services: tuple[Service, ...], changes: Changes) -> list[Instance]:
    """A core for each recorded instance, nearest to the sensor first.

    Without recorded instances, one that serves every robot. Raises UsageError for invalid settings.
    """
    foreign = sorted(set(changes) - {service.name for service in services})
    if foreign:
        raise UsageError(f"--set {foreign[0]}: is not replayed; choose one of {_names(services)}")
    return [
        _instance(survey, service, name, changes.get(service.name, {}))
        for service in services
        for name in _instances(survey, service)
    ]


def _names(services: tuple[Service, ...]) -> str:
    return ", ".join(service.name for service in services)


def _instances(survey: Survey, service: Service) -> list[str | None]:
    """Names; None for the one that nothing is known of."""
    if service.instance_field and survey.projectors:
        return [*sorted(survey.projectors)]
    reported = sorted(
        name for (of, name), reported in survey.reported.items() if of == service.name and reported.settings
    )
    return [*reported] or [None]


def _instance(survey: Survey, service: Service, name: str | None, changes: Mapping[str, str]) -> Instance:
    reported = survey.reported.get((service.name, name)) if name is not None else None
    text = (reported.settings if reported else "") or survey.settings.get(service.name, "")
    values, source = _recorded(survey, service, text)
    for setting, (channel, before) in service.later.items():
        if not survey.counts[channel]:
            values.setdefault(setting, before)
    if name is not None:
        values["instance"] = name
    settings = _settings(service, {**values, **changes})
    if changes:
        source += ", but " + ", ".join(f"{field} = {value}" for field, value in changes.items())
    robots = settings.robot if text else EVERY
    if robots == EVERY and service.instance_field and name is not None:
        robots = ",".join(sorted(survey.projectors.get(name, ()))) or EVERY
    core = service.make(settings)
    return Instance(service, settings.instance, robots, source, core, settings.model_dump_json())


def _recorded(survey: Survey, service: Service, text: str) -> tuple[dict[str, object], str]:
    """Recorded settings, without those that this version does not know; and a text on them."""
    if not text:
        return {"robot": EVERY}, "default settings, for the recording does not have them"
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UsageError(f"{survey.path}: settings of {service.name} are no JSON: {error}") from error
    if not isinstance(values, dict):
        raise UsageError(f"{survey.path}: settings of {service.name} are no JSON object")
    unknown = sorted(values.keys() - service.options.model_fields.keys())
    lost = f" without {printable(', '.join(unknown))}, which this version does not know" if unknown else ""
    # files of earlier versions also hold options of the process
    answering = service.options.answering()
    return {name: values[name] for name in values if name in answering}, f"settings as recorded{lost}"


def _settings(service: Service, values: Mapping[str, object]) -> ServiceSettings:
    known = [name for name in service.options.model_fields if name in service.options.answering()]
    for name in values:
        if name not in known:
            hint = nearest(name, known) or f": choose one of {', '.join(known)}"
            raise UsageError(f"{service.name}: {name} = {values[name]!r}: unknown{hint}")
    try:
        return service.options.model_validate(values)
    except ValidationError as error:
        fault = error.errors()[0]
        place = ".".join(map(str, fault["loc"])) or "settings"
        raise UsageError(f"{service.name}: {explained(fault, place)}") from error
