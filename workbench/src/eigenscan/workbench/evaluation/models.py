"""The models that the mapbuilder would publish for a map, and what they cost."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from eigenscan.eigenspace.embedding import CAPS
from eigenscan.eigenspace.folder import MAP, SiteModel, read_models
from eigenscan.geometry.gridmap import read_map
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import build_site
from eigenscan.schemas.channels import MODEL
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.evaluation.exhaustive import Gallery, gallery
from eigenscan.workbench.evaluation.figures import Figures


@dataclass(frozen=True)
class Built:
    """A site's models, as objects and as messages, and the figures of the build."""

    site: SiteModel
    models: list[Envelope]
    figures: Figures

    @property
    def map_m2(self) -> float:
        """Free area of the map."""
        return self.site.grid.free_area


def build(path: Path, settings: MapbuilderSettings, moved: Callable[[float], None]) -> Built:
    """Builds the models of a map_server yaml. A model folder has them; chosen settings build it again.

    `moved` is called with the progress. Raises MapError or ModelError.
    """
    is_built = path.is_dir() and not settings.model_fields_set
    before = time.perf_counter()
    if is_built:
        site = read_models(path)
    else:
        plan = replace(settings.plan, threads=os.cpu_count() or 1)
        grid = read_map(path / MAP if path.is_dir() else path)
        site = build_site(grid, plan, lambda _, share: moved(share))
    took = time.perf_counter() - before
    moved(1.0)
    models = list(MapbuilderCore(settings, site).start())
    figures = {
        "build_s": None if is_built else took,
        "wire_mb": sum(envelope.message.ByteSize() for envelope in models if envelope.channel == MODEL) / 1e6,
        "regions": len(site.regions),
        "positions": sum(len(model.index) for model in site.regions),
        "spacing_m": site.regions[0].spacing,
        "version": site.to_message().version,
    }
    return Built(site, models, figures)


def gallery_of(built: Built) -> Gallery:
    """All panoramas of the regions, positions that several regions share once."""
    regions = built.site.regions
    positions = np.vstack([model.positions for model in regions])
    panoramas = np.vstack([model.panoramas for model in regions])
    _, first = np.unique(np.round(positions, 6), axis=0, return_index=True)
    return gallery(positions[first], panoramas[first].astype(np.float64), CAPS["range"])
