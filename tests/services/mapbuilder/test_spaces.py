"""Eigenspaces for lidars unlike the declared one: made once, published once, kept with the models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.folder import SiteModel, write_models
from eigenscan.eigenspace.model import RegionModel
from eigenscan.eigenspace.space_message import space_from_message
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import GridMap
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.keeping.change_manager import ChangeManager
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.mapbuilder.spaces import KINDS, OF_ONE_ROBOT
from eigenscan.schemas.channels import LIDAR_KIND, SPACE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.model_pb2 import LidarKind, RegionSpace

SETTINGS = MapbuilderSettings()


@pytest.fixture
def site(office: GridMap) -> SiteModel:
    return build_site(office, Plan(step=TURN / 180))


def ask(beams: int, cap: float = 12.0, robot: str = "r") -> Envelope:
    address = {"site": "s", "robot": robot, "lidar": "l"}
    return Envelope(LIDAR_KIND, address, LidarKind(beams=beams, cap=cap))


def published(core: MapbuilderCore | ChangeManager, received: Envelope) -> dict[tuple[str, str], RegionSpace]:
    """Spaces by region and version of its model."""
    found = [envelope for envelope in core.handle(received) if envelope.channel is SPACE]
    messages = [envelope.open(RegionSpace) for envelope in found]
    assert [envelope.address["region"] for envelope in found] == [m.region for m in messages]
    return {(m.region, m.model_version): m for m in messages}


def started(site: SiteModel) -> MapbuilderCore:
    core = MapbuilderCore(SETTINGS, site, "s")
    assert not [envelope for envelope in core.start() if envelope.channel is SPACE]
    return core


def test_each_region_is_answered_once_for_a_kind(site: SiteModel) -> None:
    core = started(site)
    found = published(core, ask(180))
    assert set(found) == {(model.region, model.version) for model in site.regions}
    for model in site.regions:
        own = space_from_message(found[model.region, model.version].space)
        direct, _ = model.derive(own.analysis)
        assert own.analysis.beams == 180
        np.testing.assert_array_equal(own.space.vectors, direct.space.vectors)
        assert own.usual_error == direct.usual_error
    assert published(core, ask(180)) == {}
    assert len(published(core, ask(180, 5.0))) == len(site.regions)
    assert core.condition().counters["lidar_kinds"] == 2


def test_lidars_of_nearly_one_reach_have_a_key_and_a_file_each(site: SiteModel, tmp_path: Path) -> None:
    """5.6 m in single and in double precision: the second lidar's eigenspaces replaced the first one's."""
    single, third = float(np.float32(5.6)), float(np.nextafter(np.float32(5.6), np.float32(6.0)))
    core, declared = started(site), site.regions[0].space.analysis
    kinds = [
        replace(declared, embedding=replace(declared.embedding, cap=cap)) for cap in (single, 5.6, third)
    ]
    keys = [
        {envelope.key for envelope in core.handle(ask(kind.beams, kind.embedding.cap, robot=f"r{number}"))}
        for number, kind in enumerate(kinds)
    ]
    assert [len(each) for each in keys] == [len(site.regions)] * 3
    assert len(set.union(*keys)) == 3 * len(site.regions)
    beams = declared.beams
    assert kinds[0].name == f"ring5.6-{beams}"  # as ever, for a usual driver
    assert replace(declared, embedding=replace(declared.embedding, cap=12.0)).name == f"ring12-{beams}"
    write_models(site, tmp_path)
    store = Store(tmp_path)
    for kind in kinds:
        store.save_spaces(kind, {model.version: model.derive(kind)[0] for model in site.regions})
    assert set(store.load_spaces()) == set(kinds)


def test_the_declared_lidar_and_nonsense_are_not_answered(site: SiteModel) -> None:
    core = started(site)
    assert published(core, ask(91)) == {}
    for beams, cap in ((0, 12.0), (181, 12.0), (90, 0.0), (90, -1.0), (90, float("nan")), (90, 13.0)):
        assert published(core, ask(beams, cap)) == {}
    assert core.condition().counters["lidar_kind_malformed"] == 6


def test_a_site_serves_a_bounded_number_of_kinds(site: SiteModel) -> None:
    core = started(replace(site, regions=site.regions[:1]))
    answered = [bool(published(core, ask(beams, robot=f"r{beams}"))) for beams in range(10, 10 + KINDS + 3)]
    assert answered == [True] * KINDS + [False] * 3
    assert core.condition().counters["lidar_kind_beyond_limit"] == 3
    assert "3 requests for more kinds of lidars than 8" in core.condition().detail


def test_one_robot_leaves_kinds_for_the_others(site: SiteModel) -> None:
    core = started(replace(site, regions=site.regions[:1]))
    answered = [bool(published(core, ask(beams))) for beams in range(10, 10 + KINDS)]
    assert answered == [True] * OF_ONE_ROBOT + [False] * (KINDS - OF_ONE_ROBOT)
    assert published(core, ask(100, robot="r18"))
    # what others have asked for it is given as well
    assert not published(core, ask(100))
    assert core.condition().counters["lidar_kind_beyond_limit"] == KINDS - OF_ONE_ROBOT


def test_a_kind_that_was_kept_and_nobody_has_gives_way(site: SiteModel, tmp_path: Path) -> None:
    folder, one = tmp_path / "model", replace(site, regions=site.regions[:1])
    write_models(one, folder)
    first = ChangeManager(Store(folder), SETTINGS, "s")
    list(first.start())
    for beams in range(10, 10 + KINDS):
        published(first, ask(beams, robot=f"r{beams}"))
    again = ChangeManager(Store(folder), SETTINGS, "s")
    list(again.start())
    assert not published(again, ask(10, robot="r10"))
    assert published(again, ask(100, robot="r18"))
    assert len([*(folder / "spaces").iterdir()]) == KINDS
    assert not published(again, ask(10, robot="r10"))


def changed(model: RegionModel) -> RegionModel:
    return model.with_ranges(model.index, model.ranges + np.uint16(1))


def test_after_a_change_only_what_changed_is_published_again(site: SiteModel) -> None:
    core = started(site)
    published(core, ask(180))
    after = replace(site, regions=(changed(site.regions[0]), *site.regions[1:]))
    spaces = [e.open(RegionSpace) for e in core.renew(after) if e.channel is SPACE]
    assert [(m.region, m.model_version) for m in spaces] == [
        (after.regions[0].region, after.regions[0].version)
    ]


def test_what_was_made_is_kept_with_the_models_and_published_at_the_next_start(
    site: SiteModel, tmp_path: Path
) -> None:
    folder = tmp_path / "model"
    write_models(site, folder)
    first = ChangeManager(Store(folder), SETTINGS, "s")
    list(first.start())
    want = published(first, ask(180))
    (kept,) = (folder / "spaces").iterdir()
    assert first.condition().counters["spaces_kept"] == 1
    again = ChangeManager(Store(folder), SETTINGS, "s")
    spaces = [e.open(RegionSpace) for e in again.start() if e.channel is SPACE]
    assert {(m.region, m.model_version): m for m in spaces} == want
    assert published(again, ask(180)) == {}
    kept.write_bytes(kept.read_bytes()[:-500])
    damaged = ChangeManager(Store(folder), SETTINGS, "s")
    assert not [e for e in damaged.start() if e.channel is SPACE]
    assert damaged.condition().counters["spaces_damaged"] == 1
    assert published(damaged, ask(180)) == want


def test_kinds_of_other_eigenspaces_than_the_models_give_way(site: SiteModel, office: GridMap) -> None:
    """They were made again for models that nobody searches so, and kept a robot from having its own."""
    core = started(site)
    for beams in range(100, 100 + OF_ONE_ROBOT):
        assert published(core, ask(beams))
    other = build_site(office, Plan(step=TURN / 180, components=8))
    assert not [envelope for envelope in core.renew(other) if envelope.channel is SPACE]
    found = published(core, ask(100))
    assert set(found) == {(model.region, model.version) for model in other.regions}
    assert {len(one.space.eigenvalues) for one in found.values()} == {8}


def test_spaces_do_not_bring_back_a_folder_that_is_gone(site: SiteModel, tmp_path: Path) -> None:
    """A build into its place was then refused: it was there and held no models."""
    store, analysis = Store(tmp_path / "model"), site.regions[0].space.analysis
    store.save_spaces(analysis, {model.version: model.space for model in site.regions})
    assert store.counts == {"spaces_not_kept": 1}
    assert not store.folder.exists()
