"""Eigenspaces for kinds of lidar unlike the declared one: made once a site, when a robot brings one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol

from eigenscan.eigenspace.analysis import ANALYSIS_TURN, Analysis, RegionSpace
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.space_message import space_to_message
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.schemas import model_pb2
from eigenscan.schemas.channels import SPACE
from eigenscan.schemas.envelope import Envelope

KINDS = 8
"""Kinds of lidars for which a site's mapbuilder makes eigenspaces; further ones derive their own."""

Made = dict[str, RegionSpace]
"""Spaces for one kind of lidar by the version of the region's model."""


class SpaceStore(Protocol):
    """Keeps spaces between runs of the process."""

    def load_spaces(self) -> dict[Analysis, Made]:
        """Loads all spaces that are kept with the models in use."""
        ...

    def save_spaces(self, analysis: Analysis, made: Made) -> None:
        """Keeps the spaces for one kind of lidar."""
        ...


class Spaces:
    """Answers the robots' kinds of lidar; publishes each region's space for each kind once."""

    def __init__(self, site_name: str, settings: MapbuilderSettings, store: SpaceStore | None = None) -> None:
        self._site_name, self._settings, self._store = site_name, settings, store
        self._kinds: dict[Analysis, Made] = {}
        self._published: dict[tuple[str, Analysis], str] = {}
        self.counts: Counter[str] = Counter()

    def renew(self, site: SiteModel) -> Iterator[Envelope]:
        """Spaces of models that came into use, for the kinds that are kept with them or known from before."""
        if self._store is not None:
            for analysis, made in self._store.load_spaces().items():
                if self._is_answered(site, analysis):
                    self._kinds.setdefault(analysis, {}).update(made)
        for analysis in self._kinds:
            yield from self._publish(site, analysis)

    def receive(self, site: SiteModel, asked: model_pb2.LidarKind) -> Iterator[Envelope]:
        """Publishes the spaces for a kind of lidar; nothing if they exist already, or it is invalid."""
        declared = site.regions[0].space.analysis
        if not (1 <= asked.beams <= ANALYSIS_TURN and 0 < asked.cap <= declared.embedding.cap):
            self.counts["lidar_kind_malformed"] += 1
            return
        analysis = replace(declared, embedding=replace(declared.embedding, cap=asked.cap), beams=asked.beams)
        if analysis == declared or analysis in self._kinds:
            return
        if len(self._kinds) >= KINDS:
            self.counts["lidar_kind_beyond_limit"] += 1
            return
        self._kinds[analysis] = {}
        self.counts["lidar_kinds"] += 1
        yield from self._publish(site, analysis)

    def _is_answered(self, site: SiteModel, analysis: Analysis) -> bool:
        declared = site.regions[0].space.analysis
        same = (
            analysis.embedding.kind == declared.embedding.kind and analysis.components == declared.components
        )
        return same and analysis != declared and (analysis in self._kinds or len(self._kinds) < KINDS)

    def _publish(self, site: SiteModel, analysis: Analysis) -> Iterator[Envelope]:
        """The unpublished spaces of one kind, computed if they do not exist."""
        made = self._kinds[analysis]
        lacking = [model for model in site.regions if model.version not in made]
        threads = self._settings.plan.threads if lacking else 1
        with ThreadPoolExecutor(max(threads, 1)) as pool:
            for model, own in zip(lacking, pool.map(lambda m: m.derive(analysis)[0], lacking), strict=True):
                made[model.version] = own
                yield from self._publish_one(model, analysis, own)
        for model in site.regions:
            yield from self._publish_one(model, analysis, made[model.version])
        in_use = {model.version for model in site.regions}
        for version in made.keys() - in_use:
            del made[version]
        if lacking and self._store is not None:
            self._store.save_spaces(analysis, made)

    def _publish_one(self, model: RegionModel, analysis: Analysis, own: RegionSpace) -> Iterator[Envelope]:
        key = model.region, analysis
        if self._published.get(key) == model.version:
            return
        self._published[key] = model.version
        message = model_pb2.RegionSpace(
            region=model.region, model_version=model.version, space=space_to_message(own)
        )
        address = {"site": self._site_name, "region": model.region, "kind": analysis.name}
        yield Envelope(SPACE, address, message)
