"""Entry point of the projector."""

from __future__ import annotations

from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up
from eigenscan.runtime import node


def main() -> None:
    """Runs the projector until it is told to stop."""
    node.main("projector", ProjectorSettings, _make_core)


def _make_core(settings: ProjectorSettings) -> ProjectorCore:
    warm_up(settings)
    return ProjectorCore(settings)
