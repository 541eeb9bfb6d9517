"""A model folder that several processes change and read at the same time."""

from __future__ import annotations

import errno
import fcntl
import threading
from pathlib import Path
from typing import IO

import pytest
from eigenscan.eigenspace import folder as folders
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.pieces import Pieces
from eigenscan.eigenspace.versions import choose, exchange, kept_in, replace, versions
from eigenscan.geometry.gridmap import GridMap, read_map

from tests.eigenspace.test_model import model, site

ROUNDS = 15
"""Of each writer."""


def made(seed: int) -> SiteModel:
    return SiteModel(site().grid, "map", (model("a", seed), model("b", seed + 100)))


def test_two_writers_and_a_reader_never_fail_and_no_version_is_torn(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    sets = [[made(seed) for seed in seeds] for seeds in ((0, 1), (2, 3))]
    known = {each.to_message().version for own in sets for each in own}
    write_models(sets[0][0], folder)
    failed: list[str] = []

    def write(own: list[SiteModel]) -> None:
        for number in range(ROUNDS):
            try:
                write_models(own[number % 2], folder)
            except Exception as error:
                failed.append(f"write: {error!r}")

    writers = [threading.Thread(target=write, args=(own,)) for own in sets]
    for writer in writers:
        writer.start()
    while any(writer.is_alive() for writer in writers):
        try:
            assert read_models(folder).to_message().version in known
        except ModelError as error:
            failed.append(f"read: {error}")
    assert failed == []
    found = versions(folder)
    assert {version.version for version in found} == known
    for version in found:
        read_models(version.folder)
    # nothing is left of the writers' work
    assert {path.name for path in tmp_path.iterdir()} == {"m", "m.versions"}


def test_a_reader_that_is_overtaken_reads_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "m"
    write_models(made(0), folder)
    late = [made(1)]

    def slow(path: Path) -> GridMap:
        while late:
            write_models(late.pop(), folder)
        return read_map(path)

    monkeypatch.setattr(folders, "read_map", slow)
    assert read_models(folder).to_message().version == made(1).to_message().version


def test_a_version_that_another_one_removed_meanwhile_does_not_take_the_models_away(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    for seed in (0, 1):
        write_models(made(seed), folder)
    chosen = choose(versions(folder), None, folder)
    gone = chosen.folder.rename(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="No such file") as error:
        replace(folder, chosen.folder)
    assert error.value.errno == errno.ENOENT
    assert gone.is_dir()
    assert read_models(folder).to_message().version == made(1).to_message().version


@pytest.mark.parametrize("atomic", [True, False])
def test_a_failed_exchange_leaves_both_as_they_were(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, atomic: bool
) -> None:
    if not atomic:
        monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: object())
    (tmp_path / "here").mkdir()
    with pytest.raises(OSError, match="No such file"):
        exchange(tmp_path / "missing", tmp_path / "here")
    assert [path.name for path in tmp_path.iterdir()] == ["here"]


def test_a_version_that_is_just_being_written_is_none_yet(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    for seed in (0, 1):
        write_models(made(seed), folder)
    (half,) = kept_in(folder).iterdir()
    half = half.rename(half.with_name(f".{half.name}.x1"))  # as tempfile names it
    assert len(versions(folder)) == 1
    for seed in range(2, 9):
        write_models(made(seed), folder)
    assert half.is_dir()


def test_a_build_that_waited_for_the_lock_of_one_that_ended_has_a_lock_that_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It had the lock of a deleted folder: a third build began, and its pieces could not be kept."""
    before = [Pieces(tmp_path / "m")]
    before[0].__enter__()
    lock = fcntl.flock

    def late(file: IO[str], how: int) -> None:
        while before:
            before.pop().__exit__(None, None, None)
        lock(file, how)

    monkeypatch.setattr(fcntl, "flock", late)
    with Pieces(tmp_path / "m") as pieces:
        assert (pieces.place / "lock").is_file()
        with pytest.raises(ModelError, match="another build is at it"), Pieces(tmp_path / "m"):
            pass


def test_the_folder_one_is_in_can_be_built_into(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "m").mkdir()
    monkeypatch.chdir(tmp_path / "m")
    with Pieces(Path()) as pieces:
        assert pieces.place == tmp_path / "m.pieces"
