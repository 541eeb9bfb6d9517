"""A site built in shards: the same models, on any number of workers, and on after a break."""

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from eigenscan.eigenspace.folder import read_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.pieces import Pieces
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.mapbuilder.cluster import ClusterError, Workers
from eigenscan.mapbuilder.positions import Positions
from eigenscan.mapbuilder.sharded import build_pieces
from eigenscan.mapbuilder.shards import Area, shards
from eigenscan.mapbuilder.site import Plan, build_site, lay_out
from eigenscan.schemas.model_pb2 import ModelSet

pytestmark = pytest.mark.slow

QUICK = Plan(step=TURN / 180)
FINE = ["--spacing", "0.05", "--step", "1"]
"""Five shards of the office."""


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "eigenscan.cli.main", "build", *map(str, arguments)]


def build(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=600, check=False)


def published(grid: GridMap, folder: Path, plan: Plan = QUICK) -> tuple[ModelSet, int]:
    layout = lay_out(grid, plan)
    with Pieces(folder) as pieces:
        ready, found = build_pieces(grid, plan, layout, pieces)
        return pieces.publish(ready, grid, "map", None, None), found


def left_off(grid: GridMap, folder: Path) -> Pieces:
    """The pieces of a build that had all of them, and was cut before it could publish them."""
    pieces = Pieces(folder)
    with contextlib.suppress(InterruptedError), pieces:
        build_pieces(grid, QUICK, lay_out(grid, QUICK), pieces)
        raise InterruptedError
    return pieces


def test_piece_by_piece_the_models_are_those_of_the_whole(office: GridMap, tmp_path: Path) -> None:
    message, found = published(office, tmp_path / "model")
    assert found == 0
    assert message == build_site(office, QUICK).to_message()
    assert read_models(tmp_path / "model").to_message() == message
    assert sorted(p.name for p in tmp_path.iterdir()) == ["model"]


def test_shards_hold_every_region_once_and_few_positions(office: GridMap) -> None:
    areas = lay_out(office, replace(QUICK, spacing=0.1)).areas
    cut = shards(areas, 3000)
    assert sorted(area.name for shard in cut for area in shard) == [area.name for area in areas]
    assert len(cut) > 1
    assert all(len(s) == 1 or sum(len(a.positions.index) for a in s) <= 3000 for s in cut)


def test_shards_are_of_equal_work() -> None:
    def room(left: int, width: int) -> Area:
        index = np.array([(left + x, y) for x in range(width) for y in range(10)], dtype=np.int32)
        return Area(f"r{left}", Positions(index, np.zeros(2), 1.0), np.zeros((0, 2)))

    hall, rooms = room(0, 100), [room(100 + 10 * n, 10) for n in range(10)]
    cut = shards([*rooms, hall], 1999)
    assert [[area.name for area in shard] for shard in cut] == [["r0"], [area.name for area in rooms]]


def test_what_is_finished_is_not_built_again_unless_it_is_damaged(office: GridMap, tmp_path: Path) -> None:
    folder = tmp_path / "model"
    pieces = left_off(office, folder)
    assert not folder.exists()
    first, second, _ = sorted(pieces.place.glob("*.npz"))
    first.write_bytes(first.read_bytes()[:-30])
    second.write_bytes(second.read_bytes().replace(b"PK", b"KP", 1))
    message, found = published(office, folder)
    assert found == 1
    assert read_models(folder).to_message() == message == build_site(office, QUICK).to_message()


def test_pieces_of_another_map_or_plan_do_not_count(office: GridMap, tmp_path: Path) -> None:
    left_off(office, tmp_path / "model")
    other = replace(QUICK, range_cap=5.0)
    moved = replace(office, origin=np.array([0.1, 0.0, 0.0]))
    with Pieces(tmp_path / "model") as pieces:
        for grid, plan in ((office, other), (moved, QUICK)):
            assert build_pieces(grid, plan, lay_out(grid, plan), pieces)[1] == 0
        assert build_pieces(office, replace(QUICK, threads=3), lay_out(office, QUICK), pieces)[1] == 3


def test_one_build_at_a_time(tmp_path: Path) -> None:
    with (
        Pieces(tmp_path / "model"),
        pytest.raises(ModelError, match="model: another build is at it"),
        Pieces(tmp_path / "model"),
    ):
        pytest.fail("two builds at a time")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.timeout(1800)
def test_a_build_that_was_killed_goes_on_and_nothing_half_is_ever_there(
    office: GridMap, tmp_path: Path
) -> None:
    write_map(office, tmp_path / "map.yaml")
    model, pieces = tmp_path / "model", tmp_path / "model.pieces"
    process = subprocess.Popen(
        # this process gets a processor before that one: it must not end before it is killed
        ["nice", "-n", "19", *command(tmp_path / "map.yaml", "-o", model, *FINE)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    while process.poll() is None and not list(pieces.glob("*.npz")):
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.returncode == -signal.SIGKILL, "it ended before it could be killed"
    assert list(pieces.glob("*.npz"))
    assert not model.exists()
    again = build(tmp_path / "map.yaml", "-o", model, *FINE)
    assert again.returncode == 0, again.stderr
    assert "of them finished before" in again.stdout
    assert not pieces.exists()
    fresh = build(tmp_path / "map.yaml", "-o", tmp_path / "other", *FINE)
    assert "finished before" not in fresh.stdout
    one, other = (read_models(folder).to_message() for folder in (model, tmp_path / "other"))
    assert one == other


@pytest.mark.parametrize("where", ["here", "cluster"])
def test_two_workers_build_the_same_models(office: GridMap, tmp_path: Path, where: str) -> None:
    write_map(office, tmp_path / "map.yaml")
    flags = [tmp_path / "map.yaml", "-o", tmp_path / "model", "--step", "2"]
    if where == "here":
        result = build(*flags, "--workers", "2")
    else:
        with Workers(2) as workers:
            assert workers.client.scheduler is not None
            result = build(*flags, "--scheduler", workers.client.scheduler.address)
    assert result.returncode == 0, result.stderr
    # that a machine is too busy for its cluster, dask may report; how far a long build is, build does
    lines = [line for line in result.stderr.splitlines() if not line.endswith(" %")]
    assert not [line for line in lines if "unresponsive" not in line]
    expected = build_site(office, QUICK).to_message()
    assert read_models(tmp_path / "model").to_message().entries == expected.entries


def test_a_scheduler_that_is_not_there_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eigenscan.mapbuilder.cluster._PATIENCE_S", 1)
    with (
        pytest.raises(ClusterError, match=r"--scheduler tcp://127\.0\.0\.1:9: no dask scheduler"),
        Workers(address="tcp://127.0.0.1:9"),
    ):
        pass


def test_without_dask_the_extra_is_named(office: GridMap, tmp_path: Path) -> None:
    write_map(office, tmp_path / "map.yaml")
    hidden = "import sys; sys.modules['distributed'] = None; from eigenscan.cli.main import app; app()"
    flags = ["build", tmp_path / "map.yaml", "-o", tmp_path / "model", "--workers", "2"]
    result = subprocess.run(
        [sys.executable, "-c", hidden, *map(str, flags)],
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert result.returncode == 2
    assert result.stderr.strip() == (
        "eigenscan build: --workers and --scheduler need dask: pip install 'eigenscan[cluster]'"
    )


def test_a_site_that_lacks_regions_is_not_published(office: GridMap, tmp_path: Path) -> None:
    """Workers that were all gone built nothing, and the rest was published as the whole."""

    class Gone:
        count = 0

        def build(self, *_: object) -> Iterator[tuple[int, list[bytes]]]:
            yield from ()

    with Pieces(tmp_path / "model") as pieces, pytest.raises(ModelError, match=r"regions r01, .* not built"):
        build_pieces(office, QUICK, lay_out(office, QUICK), pieces, engine=Gone())
