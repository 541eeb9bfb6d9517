"""True and false are no numbers, in the settings of every service."""

import typing

import pytest
from eigenscan.ingest.settings import Mount, ScanIngestSettings
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.ros_bridge.settings import RosBridgeSettings
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.vda5050.settings import Vda5050Settings
from pydantic import BaseModel, ValidationError

KINDS: list[type[BaseModel]] = [
    Mount,
    ScanIngestSettings,
    MapbuilderSettings,
    ProjectorSettings,
    RosBridgeSettings,
    ServiceSettings,
    TrackerSettings,
    Vda5050Settings,
]
NUMBERS = [
    (kind, name)
    for kind in KINDS
    for name, field in kind.model_fields.items()
    if {int, float} & {field.annotation, *typing.get_args(field.annotation)}
]


@pytest.mark.parametrize(("kind", "name"), NUMBERS)
def test_true_is_no_number(kind: type[BaseModel], name: str) -> None:
    with pytest.raises(ValidationError):
        kind.model_validate({name: True})


def test_what_it_is_instead_is_named() -> None:
    with pytest.raises(ValidationError, match=r"mounts\.front\.x\n.*must be a number, not true or false"):
        ScanIngestSettings.model_validate({"mounts": {"front": {"x": True}}})
    assert TrackerSettings(at_once=True).at_once
