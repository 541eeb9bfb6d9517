import os
import subprocess
from pathlib import Path

import pytest
from eigenscan.eigenspace.folder import SiteModel, read_models, write_models
from eigenscan.eigenspace.model import ModelError
from eigenscan.eigenspace.versions import choose, exchange, kept_in, replace, versions

from tests.command import eigenscan
from tests.eigenspace.test_model import model, site

# written out, not taken from what is tested: a change there must show here
KEPT = 5


def build(folder: Path, seed: int, at: int) -> str:
    """Writes a set of one region into the folder, as if it was built `at` s."""
    made = SiteModel(site().grid, "map", (model("a", seed),))
    write_models(made, folder)
    os.utime(folder / "manifest.json", (at, at))
    return made.to_message().version


@pytest.fixture
def three(tmp_path: Path) -> tuple[Path, list[str]]:
    folder = tmp_path / "m"
    return folder, [build(folder, seed, 1000 + seed) for seed in range(3)]


def run(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return eigenscan("models", *arguments)


def in_use(folder: Path) -> str:
    return read_models(folder).to_message().version


def test_what_a_build_replaces_is_kept_newest_first(three: tuple[Path, list[str]]) -> None:
    folder, (first, second, third) = three
    assert [v.version for v in versions(folder)] == [third, second, first]
    assert in_use(folder) == third
    # each is a whole folder that a plain reader can open
    assert [in_use(v.folder) for v in versions(folder)] == [third, second, first]


def test_back_and_back_again_and_forth(three: tuple[Path, list[str]]) -> None:
    folder, (first, second, third) = three
    for wanted in (second, first):
        assert run("rollback", folder).returncode == 0
        assert in_use(folder) == wanted
        assert {v.version for v in versions(folder)} == {first, second, third}
    done = run("rollback", folder)
    assert done.returncode == 2
    assert "no older version is kept" in done.stderr
    assert f"; newer: {third[:12]}, {second[:12]}" in done.stderr
    assert run("rollback", folder, third[:8]).returncode == 0
    assert in_use(folder) == third


def test_the_same_models_again_are_no_new_version(three: tuple[Path, list[str]]) -> None:
    folder, (first, second, third) = three
    assert build(folder, 2, 2000) == third
    assert [v.version for v in versions(folder)] == [third, second, first]


def test_a_version_that_comes_back_by_a_build_is_listed_once(three: tuple[Path, list[str]]) -> None:
    folder, (first, second, third) = three
    assert build(folder, 0, 2000) == first
    assert [v.version for v in versions(folder)] == [first, third, second]


def test_the_oldest_goes_when_there_are_too_many(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    made = [build(folder, seed, 1000 + seed) for seed in range(KEPT + 3)]
    assert [v.version for v in versions(folder)] == made[::-1][: KEPT + 1]
    assert len(list(kept_in(folder).iterdir())) == KEPT


def test_a_damaged_version_does_not_come_into_use(three: tuple[Path, list[str]]) -> None:
    folder, (_, second, third) = three
    (versions(folder)[1].folder / "regions/a.npz").write_bytes(b"PK")
    done = run("rollback", folder)
    assert done.returncode == 2
    assert "a.npz" in done.stderr
    assert in_use(folder) == third
    assert second in {v.version for v in versions(folder)}


def test_list_marks_the_one_in_use(three: tuple[Path, list[str]]) -> None:
    folder, made = three
    lines = run("list", folder).stdout.splitlines()
    assert [line[2:14] for line in lines] == [version[:12] for version in made[::-1]]
    assert [line[0] for line in lines] == ["*", " ", " "]


def test_what_cannot_be_chosen_is_reported(three: tuple[Path, list[str]], tmp_path: Path) -> None:
    folder, made = three
    with pytest.raises(ModelError, match=r"version 'zzz' is none of those kept: there is " + made[1][:12]):
        choose(versions(folder), "zzz", folder)
    with pytest.raises(ModelError, match="is none"):
        choose(versions(folder), "", folder)
    done = run("list", tmp_path / "nothing")
    assert done.returncode == 2
    assert "holds no models" in done.stderr


@pytest.mark.parametrize("atomic", [True, False])
def test_two_folders_change_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, atomic: bool) -> None:
    if not atomic:
        monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: object())
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "who").write_text(name)
    exchange(tmp_path / "one", tmp_path / "other")
    assert (tmp_path / "one/who").read_text() == "other"
    assert (tmp_path / "other/who").read_text() == "one"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "other"]


def test_what_else_lies_among_the_versions_is_left_alone(three: tuple[Path, list[str]]) -> None:
    folder, _ = three
    other = kept_in(folder) / "notes"
    other.mkdir()
    (other / "why.txt").write_text("the shelf moved")
    for seed in range(3, 3 + KEPT + 2):
        build(folder, seed, 1000 + seed)
    assert (other / "why.txt").exists()
    assert len(versions(folder)) == KEPT + 1


def test_a_link_to_a_model_folder_stays_one_and_its_versions_lie_beside_the_folder(tmp_path: Path) -> None:
    """The link itself was swapped: it became a folder, and the version that was kept led nowhere."""
    (tmp_path / "disk").mkdir()
    link, folder = tmp_path / "m", tmp_path / "disk" / "m1"
    write_models(SiteModel(site().grid, "map", (model("a", 0),)), folder)
    link.symlink_to("disk/m1")
    write_models(SiteModel(site().grid, "map", (model("a", 1),)), link)
    assert link.is_symlink()
    assert [one.folder.parent for one in versions(link)[1:]] == [tmp_path / "disk" / "m1.versions"]
    replace(link, choose(versions(link), None, link).folder)
    assert read_models(link).regions[0].version == model("a", 0).version
    assert link.is_symlink()
