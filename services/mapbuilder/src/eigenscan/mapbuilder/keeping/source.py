"""Builds a model folder from a map, at the first start and after a change of the map or the settings.

A file beside the folder holds their hash, so accepted changes survive a restart.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from eigenscan.eigenspace.folder import write_models
from eigenscan.eigenspace.versions import MANIFEST
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.settings import MapbuilderSettings

KEEPING = frozenset({"changes", "visits", "visit"})
"""Settings that no built model depends on."""


@dataclass(frozen=True)
class Source:
    """A map, and how models are built of it."""

    grid: GridMap
    settings: MapbuilderSettings

    def is_due(self, folder: Path) -> bool:
        """Whether `folder` has no models, or models of another map or other settings."""
        if not (folder / MANIFEST).is_file():
            return True
        try:
            return _mark(folder).read_text(encoding="utf-8").strip() != self._made_of
        except (OSError, UnicodeDecodeError):  # the models were put there by hand: they are not known to fit
            return True

    def build(self, folder: Path) -> None:
        """Puts models of the map into use in `folder`; the former ones are kept as an older version.

        Raises ModelError if the map has no free position or the folder cannot be written, and OSError.
        """
        from eigenscan.mapbuilder.drawn import outlines
        from eigenscan.mapbuilder.geojson import to_geojson
        from eigenscan.mapbuilder.picture import draw_regions
        from eigenscan.mapbuilder.site import build_site, lay_out

        plan = self.settings.plan
        layout = lay_out(self.grid, plan)
        write_models(
            build_site(self.grid, plan, layout=layout),
            folder,
            draw_regions(self.grid, layout.areas),
            to_geojson(outlines(layout.regions, layout.names), plan.frame_id),
        )
        _mark(folder).write_text(self._made_of + "\n", encoding="utf-8")

    @property
    def _made_of(self) -> str:
        """Hash of this map and these settings, hex."""
        settings_json = self.settings.model_dump_json(include=set(MapbuilderSettings.model_fields) - KEEPING)
        return hashlib.sha256(f"{self.grid.version}\n{settings_json}".encode()).hexdigest()


def _mark(folder: Path) -> Path:
    return folder.with_name(folder.name + ".source")
