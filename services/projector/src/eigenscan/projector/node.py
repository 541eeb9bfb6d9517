"""Entry point of the projector."""

from __future__ import annotations

from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime import node


def main() -> None:
    """Runs the projector until it is told to stop."""
    node.main("projector", ProjectorSettings, ProjectorCore)
