from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import pytest
from eigenscan.eigenspace.folder import write_models
from eigenscan.eigenspace.versions import accept, choose, choose_proposal, replace, versions
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.keeping.change import Change
from eigenscan.mapbuilder.keeping.change_detector import ChangeDetector
from eigenscan.mapbuilder.keeping.change_manager import ChangeManager
from eigenscan.mapbuilder.keeping.source import Source
from eigenscan.mapbuilder.keeping.store import Store
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.schemas.channels import LIDAR_KIND, MODEL_SET, POSE, SCAN
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tick import TICK, tick
from pydantic import ValidationError

from tests.services.mapbuilder.keeping.patrol import KNOWN, MOVED, VISIT_S, Patrol

PULSE = tick(0)
COARSE = MapbuilderSettings(step=3.0)


def start(folder: Path, changes: Literal["off", "propose", "publish"]) -> ChangeManager:
    core = ChangeManager(Store(folder), MapbuilderSettings(changes=changes))
    assert list(core.start())[-1].channel is MODEL_SET
    return core


def come_by(core: ChangeManager, numbers: Iterable[int]) -> list[Envelope]:
    """Robots on visits of these numbers, and a pulse at the end; what was published."""
    published: list[Envelope] = []
    for number in numbers:
        for received in Patrol(number).messages(MOVED, number * VISIT_S):
            published += core.handle(received)
    return [*published, *core.handle(PULSE)]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_models(build_site(KNOWN, Plan(step=TURN / 120)), tmp_path / "model")
    return tmp_path / "model"


def test_what_is_published_can_be_taken_back_and_stays_taken_back(folder: Path) -> None:
    core, first = start(folder, "publish"), versions(folder)[0].version
    published = come_by(core, range(5))
    channels = Counter(envelope.channel.name for envelope in published)
    assert channels["map"] == channels["model_set"] == 1
    regions = core.condition().counters["regions"]
    assert 0 < channels["model"] < regions
    second = versions(folder)[0].version
    assert published[-1].open(ModelSet).version == second != first
    assert core.condition().counters["changes_published"] == 1

    replace(folder, choose(versions(folder), None, folder).folder)
    back = list(core.handle(PULSE))
    assert back[-1].open(ModelSet).version == first
    published = come_by(core, [5, 6])
    assert published == []
    assert versions(folder)[0].version == first
    assert core.condition().counters["changes_proposed"] >= 2
    assert "eigenscan models accept" in core.condition().detail


def test_a_store_that_cannot_be_written_is_reported_and_costs_no_evidence(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    core = start(folder, "propose")
    come_by(core, range(4))
    with monkeypatch.context() as broken:
        broken.setattr(Store, "propose", _full)
        come_by(core, [4])
        assert core.condition().status == Health.STATUS_DEGRADED
        assert "No space left" in core.condition().detail
    come_by(core, [5])
    assert core.condition().status == Health.STATUS_OK
    assert core.condition().counters["changes_proposed"] == 1


def test_a_change_that_could_not_be_published_is_published_after_the_next_visit(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    core, first = start(folder, "publish"), versions(folder)[0].version
    known, moved = KNOWN.cells == OCCUPIED, MOVED.cells == OCCUPIED
    # every visit shows the very same
    monkeypatch.setattr(ChangeDetector, "receive", lambda *_: Change(MOVED, moved & ~known, known & ~moved))
    visit = next(each for each in Patrol(0).messages(MOVED, 0.0) if each.channel is SCAN)
    with monkeypatch.context() as broken:
        broken.setattr("eigenscan.eigenspace.versions.exchange", _full)
        list(core.handle(visit))
        assert core.condition().status == Health.STATUS_DEGRADED
        assert versions(folder)[0].version == first
    list(core.handle(visit))
    assert core.condition().status == Health.STATUS_OK
    assert core.condition().counters["changes_published"] == 1
    assert versions(folder)[0].version != first


@pytest.mark.parametrize("days", [2, -2])
def test_a_robot_whose_clock_is_days_off_keeps_nobody_from_seeing_a_change(folder: Path, days: int) -> None:
    core = start(folder, "propose")
    for number in range(6):
        right = Patrol(number).messages(MOVED, number * VISIT_S, robot="r1")
        wrong = Patrol(number).messages(MOVED, number * VISIT_S + days * 86_400, robot="r2")
        for pair in zip(right, wrong, strict=True):
            for received in pair:
                list(core.handle(received))
    list(core.handle(tick(0)))
    condition = core.condition()
    assert condition.counters["changes_proposed"] == 2
    assert condition.counters["looks_of_another_day"] > 0
    assert condition.status == Health.STATUS_DEGRADED
    assert condition.detail == "the clock of r2 and those of other robots are over a day apart: set them"


def test_time_that_went_on_by_days_is_no_fault(folder: Path) -> None:
    core = start(folder, "propose")
    for number in range(6):
        for received in Patrol(number).messages(MOVED, number * 3 * 86_400):
            list(core.handle(received))
    assert core.condition().status == Health.STATUS_OK


def _full(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_models_that_cannot_be_read_leave_those_that_were_published(folder: Path) -> None:
    core, manifest = start(folder, "off"), folder / "manifest.json"
    assert core.inputs == (TICK, LIDAR_KIND)
    good = manifest.read_text()
    manifest.write_text("{")
    assert list(core.handle(PULSE)) == []
    assert core.condition().status == Health.STATUS_DEGRADED
    assert "manifest.json" in core.condition().detail
    manifest.write_text(good + " ")
    assert [published.channel.name for published in core.handle(PULSE)] == ["map", "model_set"]
    assert core.condition().status == Health.STATUS_OK


def test_a_folder_that_was_away_for_a_while_is_no_lasting_fault(folder: Path) -> None:
    core, away = start(folder, "off"), folder.with_name("away")
    folder.rename(away)
    assert [*core.handle(PULSE), *core.handle(PULSE)] == []
    assert core.condition().status == Health.STATUS_DEGRADED
    assert core.condition().counters["models_unreadable"] == 1
    away.rename(folder)
    list(core.handle(PULSE))
    assert core.condition().status == Health.STATUS_OK


def test_a_map_alone_cannot_be_kept() -> None:
    with pytest.raises(ValidationError, match="eigenscan build"):
        MapbuilderOptions(map="map.yaml", changes="propose")
    assert MapbuilderCore(MapbuilderSettings(), KNOWN).inputs == (LIDAR_KIND,)


def from_map(folder: Path, grid: GridMap, settings: MapbuilderSettings = COARSE) -> tuple[ChangeManager, str]:
    """A mapbuilder with map and model folder, started; the version that it published."""
    core = ChangeManager(Store(folder), settings, source=Source(grid, settings))
    assert core.condition().status == Health.STATUS_WAITING
    *_, whole = core.start()
    assert core.condition().status == Health.STATUS_OK
    return core, whole.open(ModelSet).version


def test_a_folder_that_is_made_of_a_map_is_kept_true_and_outlives_a_start(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    core, first = from_map(folder, KNOWN)
    assert {SCAN, POSE} <= set(core.inputs)
    come_by(core, range(5))
    assert "eigenscan models accept" in core.condition().detail
    accept(folder, choose_proposal(versions(folder), None, folder).folder)
    accepted = versions(folder)[0].version
    _, again = from_map(folder, KNOWN)
    assert again == accepted != first


def test_another_map_or_other_settings_make_other_models_and_keep_those_before(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    _, first = from_map(folder, KNOWN)
    stood = {path: path.stat().st_mtime_ns for path in folder.iterdir()}
    _, same = from_map(folder, KNOWN, COARSE.model_copy(update={"visits": 7}))
    assert (same, {path: path.stat().st_mtime_ns for path in folder.iterdir()}) == (first, stood)
    _, moved = from_map(folder, MOVED)
    _, finer = from_map(folder, MOVED, COARSE.model_copy(update={"spacing": 0.75}))
    assert len({first, moved, finer}) == 3
    assert {first, moved} <= {version.version for version in versions(folder)[1:]}


def test_models_that_cannot_be_read_are_made_again_of_their_map(tmp_path: Path) -> None:
    folder = tmp_path / "model"
    _, first = from_map(folder, KNOWN)
    (folder / "manifest.json").write_text("{")
    core, again = from_map(folder, KNOWN)
    assert again == first
    assert core.condition().counters["models_unreadable"] == 1
