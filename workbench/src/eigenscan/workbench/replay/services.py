"""The services that can be replayed, and what each takes to make its core."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.options import ScanIngestOptions
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.options import ProjectorOptions
from eigenscan.runtime.settings import ServiceSettings
from eigenscan.schemas.channels import TRANSFORM, Channel
from eigenscan.schemas.envelope import Core
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.options import TrackerOptions


@dataclass(frozen=True)
class Service:
    """A service by its name, and what tells its instances apart in the keys it speaks on."""

    name: str
    options: type[ServiceSettings]
    make: Callable[[Any], Core]
    hears: tuple[Channel, ...]
    says: tuple[Channel, ...]
    instance_field: str | None = None


SCAN_INGEST = Service(
    "scan-ingest", ScanIngestOptions, ScanIngestCore, ScanIngestCore.hears, ScanIngestCore.says
)
PROJECTOR = Service(
    "projector",
    ProjectorOptions,
    lambda options: ProjectorCore(options, options.instance),
    ProjectorCore.hears,
    ProjectorCore.says,
    "projector",
)
TRACKER = Service("tracker", TrackerOptions, TrackerCore, TrackerCore.hears, TrackerCore.says)

PARTS: tuple[Service, ...] = (SCAN_INGEST, PROJECTOR, TRACKER)
"""From the sensor on."""

PIPELINE = "pipeline"
CHOICES: dict[str, tuple[Service, ...]] = {part.name: (part,) for part in PARTS} | {PIPELINE: PARTS}
"""What `--service` takes; `pipeline` is all of them in a row, each receiving what the last one publishes."""

ARRIVAL: dict[Channel, str] = {
    TRANSFORM: "one follows each odometry sample, and rests on the newest pose that was there by then: "
    "an accident of arrival",
}
"""What is not judged of a recording over Zenoh, and why. The poses that a transform rests on are judged."""


def published_by(services: tuple[Service, ...]) -> tuple[Channel, ...]:
    """Channels that these services speak on."""
    return tuple(channel for service in services for channel in service.says)


def received_by(cores: Sequence[Core], published: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Channels that must come from the recording: the cores receive, but do not publish them."""
    channels = (channel for core in cores for channel in core.hears if channel not in published)
    return tuple(dict.fromkeys(channels))
