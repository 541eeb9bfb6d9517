"""mapbuilder as a process."""

from __future__ import annotations

from eigenscan.eigenspace.folder import SiteModel, read_models
from eigenscan.geometry.gridmap import GridMap, read_map
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.runtime.node import main as run


def _source(settings: MapbuilderSettings) -> GridMap | SiteModel:
    if settings.model is not None:
        return read_models(settings.model)
    assert settings.map is not None  # the settings hold one of the two
    return read_map(settings.map)


def main() -> None:
    """Entry point of `eigenscan-mapbuilder`."""
    run("mapbuilder", MapbuilderSettings, lambda settings: MapbuilderCore(settings, _source(settings)))


if __name__ == "__main__":
    main()
