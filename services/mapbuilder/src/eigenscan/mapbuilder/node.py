"""mapbuilder as a process."""

from __future__ import annotations

from eigenscan.schemas.envelope import Core
from eigenscan.schemas.extra import needs

with needs("eigenscan-mapbuilder[node]", SystemExit):
    from eigenscan.mapbuilder.options import MapbuilderOptions
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run
    from eigenscan.runtime.settings import SettingsError


def make_core(options: MapbuilderOptions) -> Core:
    """The core over a map, or over a model folder that it follows."""
    from eigenscan.geometry.gridmap import read_map  # these take their time: neighbours are found meanwhile
    from eigenscan.mapbuilder.core import MapbuilderCore

    if options.model is not None:
        from eigenscan.eigenspace.folder import floor_names
        from eigenscan.mapbuilder.keeping.change_manager import ChangeManager
        from eigenscan.mapbuilder.keeping.source import Source
        from eigenscan.mapbuilder.keeping.store import Store

        store = Store(options.model)
        source = Source(read_map(options.map), options) if options.map is not None else None
        if source is not None:
            if floors := floor_names(options.model):
                raise SettingsError(
                    f"map = {options.map}: {options.model} holds the floors {', '.join(floors)}, which "
                    "models of this one map would replace: remove map from the settings"
                )
            options.model.parent.mkdir(parents=True, exist_ok=True)
        if options.changes in ("propose", "publish") and not store.is_writable:
            raise SettingsError(
                f"{options.model}: nothing can be written beside it: set changes to off, or free the place"
            )
        return ChangeManager(store, options, options.site, source)
    assert options.map is not None  # the options hold one of the two
    return MapbuilderCore(options, read_map(options.map), options.site)


BATCH_S = 0.2
"""Scans may wait, since nobody waits for an answer: to wake for each costs more than the scan itself."""

SERVICE = Service("mapbuilder", MapbuilderOptions, make_core, batch_s=lambda _: BATCH_S)


def main() -> None:
    """Entry point of `eigenscan-mapbuilder`."""
    run(SERVICE)


if __name__ == "__main__":
    main()
