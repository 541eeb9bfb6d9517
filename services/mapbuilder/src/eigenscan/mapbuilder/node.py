"""mapbuilder as a process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.runtime.node import main as run
from eigenscan.runtime.settings import SettingsError

if TYPE_CHECKING:
    from eigenscan.mapbuilder.core import MapbuilderCore


def make_core(settings: MapbuilderSettings) -> MapbuilderCore:
    """The core over a map, or over a model folder that it follows."""
    from eigenscan.geometry.gridmap import read_map  # these take their time: neighbours are found meanwhile
    from eigenscan.mapbuilder.core import MapbuilderCore
    from eigenscan.mapbuilder.keeping.store import Store

    if settings.model is not None:
        store = Store(settings.model)
        if settings.changes in ("propose", "publish") and not store.is_writable:
            raise SettingsError(
                f"{settings.model}: nothing can be written beside it: set changes to off, or free the place"
            )
        site = store.renewed()
        assert site is not None  # the first time it is new
        return MapbuilderCore(settings, site, store)
    assert settings.map is not None  # the settings hold one of the two
    return MapbuilderCore(settings, read_map(settings.map))


def main() -> None:
    """Entry point of `eigenscan-mapbuilder`."""
    run("mapbuilder", MapbuilderSettings, make_core)


if __name__ == "__main__":
    main()
