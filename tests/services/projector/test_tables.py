"""Regions that are made ready as scans ask for them, and what is kept of them."""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.analysis import ANALYSIS_TURN, HEADING_STRIDE
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.projector import tables
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.first_look import BEAMS, CAP, WRONG, first_look
from eigenscan.projector.observation import observe
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.table_folder import TableFolder
from eigenscan.schemas.channels import LIDAR_KIND, SCAN, SPACE
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan

from tests.services.projector.office import (
    ADDRESS,
    envelopes,
    free_poses,
    is_right,
    poses_of,
    receive,
    scan_at,
    site,
)

WIDE = 2 * np.pi


@pytest.fixture
def one_a_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PER_SCAN", "DERIVED_PER_SCAN"):
        monkeypatch.setattr(tables, name, 1)


def _core(
    store: Path | None = None, aside: Callable[[Callable[[], None]], None] | None = None
) -> ProjectorCore:
    core = ProjectorCore(ProjectorSettings(), store=TableFolder(store) if store else None, aside=aside)
    for envelope in envelopes(site()):
        assert list(core.handle(envelope)) == []
    return core


def _at_once(work: Callable[[], None]) -> None:
    work()


def _answer(core: ProjectorCore, scan: Scan) -> bytes:
    return receive(core, scan)[0].SerializeToString(deterministic=True)


def _tables(core: ProjectorCore) -> tables.Tables:
    assert core._view is not None
    return core._view.tables


@pytest.mark.usefixtures("one_a_scan")
@pytest.mark.parametrize("view", [np.pi, WIDE])
def test_a_scan_waits_for_few_regions_and_states_which_they_are(view: float) -> None:
    """Until all are ready an answer is about less than the site, and states nothing about the rest."""
    core, truth = _core(), free_poses(1, 3)[0]
    areas, unlisted = [], []
    for i in range(len(site().regions) + 1):
        message, _ = receive(core, scan_at(truth, field_of_view=view, seed=i))
        areas.append(message.searched_area_m2)
        unlisted.append(message.unlisted_log_likelihood)
    assert np.all(np.diff(areas) >= 0)
    assert areas[0] < areas[-1] == pytest.approx(site().grid.free_area)
    assert unlisted[0] == 0.0
    scan, whole = scan_at(truth, field_of_view=view), _core()
    receive(whole, scan)
    assert whole._view is not None
    whole._view.complete()
    assert _answer(core, scan) == _answer(whole, scan)


@pytest.mark.usefixtures("one_a_scan")
@pytest.mark.parametrize("view", [np.pi, WIDE])
def test_what_is_made_aside_or_kept_changes_no_answer(view: float, tmp_path: Path) -> None:
    scans = [scan_at(p, field_of_view=view, seed=i) for i, p in enumerate(free_poses(6, 4))]
    plain = _core()
    want = [_answer(plain, scan) for scan in scans]
    done = _core(tmp_path, _at_once)
    assert [_answer(done, scan) for scan in scans] == want
    assert done.condition().counters["tables_kept"] == 1
    again = _core(tmp_path, _at_once)
    assert [_answer(again, scan) for scan in scans] == want
    counters = again.condition().counters
    assert (counters["tables_taken"], counters.get("tables_kept", 0)) == (1, 0)


def test_the_likeliest_region_is_made_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tables, "PER_SCAN", 2)
    truths = free_poses(15, 9)
    right = [
        bool(is_right(poses_of(receive(_core(), scan_at(truth, seed=i))[0])[:1], truth)[0])
        for i, truth in enumerate(truths)
    ]
    assert sum(right) >= 12


def test_health_states_how_far_the_work_aside_is() -> None:
    waiting: list[Callable[[], None]] = []
    core = _core(aside=waiting.append)
    total = len(site().regions)
    receive(core, scan_at(free_poses(1, 3)[0]))
    made = _tables(core).made
    if made < total:
        assert f"eigenspaces for this lidar: {made} of {total} regions" in core.condition().detail
    for work in waiting:
        work()
    assert "eigenspaces" not in core.condition().detail
    assert _tables(core).made == total


def _flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-1 - len(data) // 3] ^= 0x55
    path.write_bytes(bytes(data))


def _flip_all(folder: Path) -> None:
    for path in folder.glob("*.npy"):
        _flip(path)


@pytest.mark.parametrize(
    "harm",
    [
        _flip_all,
        lambda folder: _flip(folder / "blocks.npy"),
        lambda folder: _flip(folder / "vectors.npy"),
        lambda folder: (folder / "rows.npy").write_bytes(b"\x93NUMPY"),
        lambda folder: (folder / "rows.npy").unlink(),
        lambda folder: np.save(folder / "prior.npy", np.zeros((1, 16))),
        lambda folder: np.save(folder / "blocks.npy", np.array([{}]), allow_pickle=True),
        lambda folder: (folder / "sums.npy").write_bytes(b""),
        shutil.rmtree,
    ],
)
def test_kept_tables_that_are_damaged_are_made_again(harm: Callable[[Path], object], tmp_path: Path) -> None:
    scans = [scan_at(p, field_of_view=WIDE, seed=i) for i, p in enumerate(free_poses(4, 4))]
    want = [_answer(core, scan) for core in [_core(tmp_path, _at_once)] for scan in scans]
    (kept,) = tmp_path.iterdir()
    harm(kept)
    core = _core(tmp_path, _at_once)
    assert [_answer(core, scan) for scan in scans] == want
    if kept.with_name(f"{kept.name}.damaged").exists():
        assert core.condition().counters["tables_damaged"] >= 1
    after = _core(tmp_path, _at_once)
    assert [_answer(after, scan) for scan in scans] == want


def test_tables_of_another_model_or_lidar_are_not_taken(tmp_path: Path) -> None:
    receive(_core(tmp_path, _at_once), scan_at(free_poses(1, 3)[0]))
    other = ProjectorCore(ProjectorSettings(), store=TableFolder(tmp_path), aside=_at_once)
    for envelope in envelopes(site(of="tower")):
        list(other.handle(envelope))
    receive(other, scan_at(free_poses(1, 3)[0]))
    assert "tables_taken" not in other.condition().counters
    receive(other, scan_at(free_poses(1, 3)[0], field_of_view=WIDE))
    assert other.condition().counters["tables_kept"] == 2


def test_a_folder_that_may_only_be_read_gives_its_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sound tables were counted as damaged, because their time of use could not be written."""
    folder, array = TableFolder(tmp_path), np.arange(4)
    folder.save("one", {"a": array})

    def refuse(*_: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(Path, "touch", refuse)
    found = folder.load("one", {"a": array})
    assert found is not None
    assert (found["a"] == array).all()
    assert folder.counts == {"tables_kept": 1, "tables_taken": 1}


def test_what_a_process_left_that_ended_while_it_saved_is_removed(tmp_path: Path) -> None:
    """Each such end cost as much disk as the tables are large, for good."""
    left, at_work = tmp_path / ".left", tmp_path / ".at_work"
    for path in (left, at_work):
        path.mkdir()
    os.utime(left, (0.0, 0.0))
    TableFolder(tmp_path).save("one", {"a": np.arange(4)})
    assert {path.name for path in tmp_path.iterdir()} == {".at_work", "one"}


def test_a_full_disk_is_counted_and_costs_no_answer(tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("")
    core = _core(place / "tables", _at_once)
    message, _ = receive(core, scan_at(free_poses(1, 3)[0]))
    assert message.hypotheses
    assert core.condition().counters["tables_not_kept"] == 1


@pytest.mark.parametrize(
    ("view", "reach"), [(WIDE, 30.0), (np.deg2rad(100), 30.0), (np.pi, 6.0), (WIDE, 4.0)]
)
def test_the_mapbuilders_spaces_are_the_projectors_own_to_the_bit(view: float, reach: float) -> None:
    """Asked for with a scan, answered once; the answers are the same with them and without."""
    truths = free_poses(5, 12)
    scans = [scan_at(p, field_of_view=view, range_max=reach, seed=i) for i, p in enumerate(truths)]
    alone, reported = _core(), _core()
    output = list(alone.handle(Envelope(SCAN, ADDRESS, scans[0])))
    (asked,) = (envelope for envelope in output if envelope.channel is LIDAR_KIND)
    builder = MapbuilderCore(MapbuilderSettings(), site(), "s")
    list(builder.start())
    spaces = list(builder.handle(asked))
    assert len(spaces) == len(site().regions) == len({envelope.key for envelope in spaces})
    assert all(envelope.channel is SPACE for envelope in spaces)
    assert list(builder.handle(asked)) == []
    for envelope in spaces:
        assert list(reported.handle(envelope)) == []
    for scan in scans:
        assert _answer(reported, scan) == _answer(alone, scan)
    own, received = _tables(alone), _tables(reported)
    assert received.is_known
    assert not own.is_known
    for name in ("mean", "vectors", "prior"):
        np.testing.assert_array_equal(getattr(own.subspaces, name), getattr(received.subspaces, name))
    np.testing.assert_array_equal(own.usual_error, received.usual_error)
    assert not any(e.channel is LIDAR_KIND for e in reported.handle(Envelope(SCAN, ADDRESS, scans[0])))


def test_who_is_not_answered_asks_again_later() -> None:
    core, truth = _core(), free_poses(1, 3)[0]

    def asks(seconds: float) -> bool:
        scan = scan_at(truth, field_of_view=WIDE, time=int(seconds * 1e9))
        return any(e.channel is LIDAR_KIND for e in core.handle(Envelope(SCAN, ADDRESS, scan)))

    assert [asks(at) for at in (1.0, 2.0, 10.9, 11.1, 12.0)] == [True, False, False, True, False]
    assert not any(e.channel is LIDAR_KIND for e in core.handle(Envelope(SCAN, ADDRESS, scan_at(truth))))


def test_a_damaged_space_is_refused_by_name_and_the_lidar_is_served() -> None:
    core = _core()
    output = list(core.handle(Envelope(SCAN, ADDRESS, scan_at(free_poses(1, 3)[0], field_of_view=WIDE))))
    builder = MapbuilderCore(MapbuilderSettings(), site(), "s")
    list(builder.start())
    for envelope in builder.handle(output[-1]):
        envelope.message.space.vectors[3] = float("nan")  # type: ignore[attr-defined]
        list(core.handle(envelope))
    assert core.condition().counters["refused_space"] == len(site().regions)
    assert "space: holds numbers that are not finite" in core.condition().detail
    assert receive(core, scan_at(free_poses(1, 3)[0], field_of_view=WIDE))[0].status == Hypotheses.STATUS_OK


def test_the_first_look_is_the_least_truncated_error_over_all_positions_and_headings() -> None:
    core = _core()
    assert core._site is not None
    lattice = core._site.lattice
    seen = observe(scan_at(free_poses(1, 21)[0], field_of_view=np.deg2rad(150)))
    found = first_look(lattice, seen.coarse, seen.used)
    among = np.flatnonzero(seen.used)
    beams = among[np.linspace(0, len(among) - 1, BEAMS).astype(int)]
    for own, cost in zip(lattice.regions, found, strict=True):
        least = np.inf
        for heading in range(0, ANALYSIS_TURN, HEADING_STRIDE):
            there = np.minimum(lattice.panoramas[own][:, (heading + beams) % ANALYSIS_TURN], CAP)
            off = np.minimum(np.abs(there - np.minimum(seen.coarse[beams], CAP)), WRONG)
            least = min(least, float(off.sum(axis=1).min()))
        assert cost == pytest.approx(least, abs=1e-4)


def test_a_new_set_forgets_spaces_of_models_that_are_gone() -> None:
    core = _core()
    output = list(core.handle(Envelope(SCAN, ADDRESS, scan_at(free_poses(1, 3)[0], field_of_view=WIDE))))
    builder = MapbuilderCore(MapbuilderSettings(), site(), "s")
    list(builder.start())
    for envelope in builder.handle(output[-1]):
        list(core.handle(envelope))
    first = site().regions[0]
    changed = first.with_ranges(first.index, first.ranges + np.uint16(1))
    for envelope in envelopes(replace(site(), regions=(changed, *site().regions[1:]))):
        list(core.handle(envelope))
    assert {version for version, _ in core._spaces} == {model.version for model in site().regions[1:]}
