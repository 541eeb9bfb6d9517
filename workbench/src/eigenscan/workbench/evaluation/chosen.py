"""The settings of the services that an evaluation runs, as their users choose them."""

from __future__ import annotations

from dataclasses import dataclass, field

from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector.options import ProjectorOptions
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.choices import Choices
from eigenscan.tracker.options import TrackerOptions
from eigenscan.tracker.settings import TrackerSettings

SERVICES = ("scan-ingest", "projector", "tracker", "mapbuilder")
"""Services whose settings an evaluation takes."""


@dataclass(frozen=True)
class PipelineSettings:
    """Settings of the cores; the services' defaults if nothing is chosen."""

    ingest: ScanIngestSettings = field(default_factory=ScanIngestSettings)
    projector: ProjectorSettings = field(default_factory=ProjectorSettings)
    tracker: TrackerSettings = field(default_factory=TrackerSettings)
    mapbuilder: MapbuilderSettings = field(default_factory=MapbuilderSettings)


def chosen(choices: Choices, spacing: float | None = None) -> PipelineSettings:
    """Settings of a user's choices; `spacing`, m, wins over them.

    Raises SettingsError that names the option or file, the field and the fix.
    """
    mapbuilder = choices.core(MapbuilderOptions, MapbuilderSettings, "mapbuilder")
    if spacing is not None:
        mapbuilder = mapbuilder.model_copy(update={"spacing": spacing})
    return PipelineSettings(
        choices.core(ScanIngestOptions, ScanIngestSettings, "scan-ingest"),
        choices.core(ProjectorOptions, ProjectorSettings, "projector"),
        choices.core(TrackerOptions, TrackerSettings, "tracker"),
        mapbuilder,
    )
