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

KINDS, OF_ONE_ROBOT = 8, 2
"""Kinds of lidars for which a site's mapbuilder makes eigenspaces, in all and of one robot.

Further ones derive their own.
"""

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

    def drop_spaces(self, analysis: Analysis) -> None:
        """Keeps them no longer."""
        ...


class Spaces:
    """Answers the robots' kinds of lidar; publishes each region's space for each kind once."""

    def __init__(self, site_name: str, settings: MapbuilderSettings, store: SpaceStore | None = None) -> None:
        self._site_name, self._settings, self._store = site_name, settings, store
        self._kinds: dict[Analysis, Made] = {}
        self._asked_by: dict[Analysis, str] = {}
        """The robot that first asked for a kind; a kind that was kept may have none."""
        self._published: dict[tuple[str, Analysis], str] = {}
        self.counts: Counter[str] = Counter()

    def renew(self, site: SiteModel) -> Iterator[Envelope]:
        """Spaces of models that came into use, for the kinds that are kept with them or known from before.

        Kinds of other eigenspaces than the models', which no projector searches, are forgotten.
        """
        self._kinds = {kind: made for kind, made in self._kinds.items() if self._is_answered(site, kind)}
        self._asked_by = {kind: robot for kind, robot in self._asked_by.items() if kind in self._kinds}
        if self._store is not None:
            for analysis, made in self._store.load_spaces().items():
                if self._is_answered(site, analysis):
                    self._kinds.setdefault(analysis, {}).update(made)
        for analysis in self._kinds:
            yield from self._publish(site, analysis)

    def receive(self, site: SiteModel, asked: model_pb2.LidarKind, robot: str) -> Iterator[Envelope]:
        """Publishes the spaces for a robot's kind of lidar; nothing if they exist, or it is invalid."""
        declared = site.regions[0].space.analysis
        if not (1 <= asked.beams <= ANALYSIS_TURN and 0 < asked.cap <= declared.embedding.cap):
            self.counts["lidar_kind_malformed"] += 1
            return
        analysis = replace(declared, embedding=replace(declared.embedding, cap=asked.cap), beams=asked.beams)
        if analysis == declared:
            return
        if [*self._asked_by.values()].count(robot) >= OF_ONE_ROBOT and self._asked_by.get(analysis) != robot:
            self.counts["lidar_kind_beyond_limit"] += analysis not in self._kinds
            return
        if analysis in self._kinds:
            self._asked_by.setdefault(analysis, robot)
            return
        if len(self._kinds) >= KINDS and not self._forget_one():
            self.counts["lidar_kind_beyond_limit"] += 1
            return
        self._kinds[analysis], self._asked_by[analysis] = {}, robot
        self.counts["lidar_kinds"] += 1
        yield from self._publish(site, analysis)

    def _forget_one(self) -> bool:
        """Forgets a kind that was kept and that no robot has asked for; whether there was one."""
        unused = next((kind for kind in self._kinds if kind not in self._asked_by), None)
        if unused is None:
            return False
        del self._kinds[unused]
        if self._store is not None:
            self._store.drop_spaces(unused)
        return True

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
