"""mapbuilder as a process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.runtime.node import main as run
from eigenscan.runtime.settings import SettingsError

if TYPE_CHECKING:
    from eigenscan.mapbuilder.core import MapbuilderCore


def make_core(options: MapbuilderOptions) -> MapbuilderCore:
    """The core over a map, or over a model folder that it follows."""
    from eigenscan.geometry.gridmap import read_map  # these take their time: neighbours are found meanwhile
    from eigenscan.mapbuilder.core import MapbuilderCore
    from eigenscan.mapbuilder.keeping.store import Store

    if options.model is not None:
        store = Store(options.model)
        if options.changes in ("propose", "publish") and not store.is_writable:
            raise SettingsError(
                f"{options.model}: nothing can be written beside it: set changes to off, or free the place"
            )
        site = store.renewed()
        assert site is not None  # the first time it is new
        return MapbuilderCore(options, site, store, options.site)
    assert options.map is not None  # the options hold one of the two
    return MapbuilderCore(options, read_map(options.map), site=options.site)


def main() -> None:
    """Entry point of `eigenscan-mapbuilder`."""
    run("mapbuilder", MapbuilderOptions, make_core)


if __name__ == "__main__":
    main()
