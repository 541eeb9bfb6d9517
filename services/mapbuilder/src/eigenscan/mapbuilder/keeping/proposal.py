"""Builds the models after a change, with a text for the operator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from eigenscan.eigenspace.folder import SiteModel
from eigenscan.mapbuilder.keeping.change import Change
from eigenscan.mapbuilder.keeping.picture import draw_change
from eigenscan.mapbuilder.keeping.rebuild import rebuild
from eigenscan.mapbuilder.settings import MapbuilderSettings


@dataclass(frozen=True)
class Proposal:
    """Models that fit the evidence. `about`: a file beside them; `words`: the change in short."""

    site: SiteModel
    about: Mapping[str, Any]
    picture: bytes
    words: str

    @classmethod
    def of(cls, site: SiteModel, change: Change, settings: MapbuilderSettings) -> Proposal:
        """The proposal for a change of the models in use. Raises ModelError if no models can be built."""
        fresh, places = rebuild(site, change.grid, settings.plan), change.places()
        new = sum(place.is_new for place in places)
        words = f"{new} new, {len(places) - new} gone on {settings.visits} visits in a row"
        before = {model.region: model.version for model in site.regions}
        about = {
            "since": site.to_message().version,
            "visits": settings.visits,
            "regions": [m.region for m in fresh.regions if before[m.region] != m.version],
            "places": [
                {
                    "what": "new" if place.is_new else "gone",
                    "x": round(place.centre[0], 2),
                    "y": round(place.centre[1], 2),
                    "sides_m": [round(side, 2) for side in place.sides],
                }
                for place in places
            ],
        }
        picture = draw_change(site.grid, change, f"red is new, blue is gone: {words}")
        return cls(fresh, about, picture, words)
