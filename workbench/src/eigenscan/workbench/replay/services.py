"""The services that can be replayed, and the parts of their cores."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.options import ProjectorOptions
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import ADVICE, LIDAR_KIND, TRANSFORM, Channel
from eigenscan.schemas.envelope import Core
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.options import TrackerOptions


@dataclass(frozen=True)
class Service:
    """A service by its name, and the field of its keys that names an instance."""

    name: str
    options: type[ServiceSettings]
    make: Callable[[Any], Core]
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    instance_field: str | None = None
    later: Mapping[str, tuple[Channel, object]] = field(default_factory=dict)
    """Settings that earlier versions lack: what only versions with them publish, and the value before."""


SCAN_INGEST = Service(
    "scan-ingest", ScanIngestOptions, ScanIngestCore, ScanIngestCore.inputs, ScanIngestCore.outputs
)
PROJECTOR = Service(
    "projector",
    ProjectorOptions,
    lambda options: ProjectorCore(options, options.instance),
    ProjectorCore.inputs,
    ProjectorCore.outputs,
    "projector",
    {"advice": (ADVICE, False)},
)
TRACKER = Service("tracker", TrackerOptions, TrackerCore, TrackerCore.inputs, TrackerCore.outputs)

PARTS: tuple[Service, ...] = (SCAN_INGEST, PROJECTOR, TRACKER)
"""Nearest to the sensor first."""

PIPELINE = "pipeline"
CHOICES: dict[str, tuple[Service, ...]] = {part.name: (part,) for part in PARTS} | {PIPELINE: PARTS}
"""Values of `--service`; `pipeline` is all services in a row, each receiving the last one's answers."""

ARRIVAL: dict[Channel, str] = {
    TRANSFORM: "one follows each odometry sample, and rests on the newest pose that was there by then: "
    "an accident of arrival",
    ADVICE: "one follows each second of those poses and tracks that the projector had received in pairs: "
    "an accident of arrival",
    LIDAR_KIND: "the projector asks only until the eigenspaces for a lidar have come: an accident of arrival",
}
"""What is not judged for a recording over Zenoh, and why. The poses and tracks behind it are judged."""


def published_by(services: tuple[Service, ...]) -> tuple[Channel, ...]:
    """Channels that these services speak on."""
    return tuple(channel for service in services for channel in service.outputs)


def received_by(cores: Sequence[Core], published: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Channels that must come from the recording: the cores receive, but do not publish them."""
    channels = (channel for core in cores for channel in core.inputs if channel not in published)
    return tuple(dict.fromkeys(channels))
