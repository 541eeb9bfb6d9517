import errno
import os
from pathlib import Path

import pytest
from eigenscan.runtime.inbox import Arrival
from eigenscan.runtime.latched_cache import LatchedCache
from eigenscan.schemas.channels import MODEL, MODEL_SET
from eigenscan.schemas.wire import encoding


def model(region: str, payload: bytes) -> Arrival:
    return Arrival(MODEL, f"site/model/{region}", payload, encoding(MODEL))


def test_another_process_reads_what_was_received_in_that_order(tmp_path: Path) -> None:
    received = [model("hall", b"1"), model("room", b"1\n2"), Arrival(MODEL_SET, "site/models", b"", "x")]
    first = LatchedCache(tmp_path / "new/folder")
    for sample in [*received, received[1]]:  # the newest again is no news
        first.put(sample)
    assert list(LatchedCache(tmp_path / "new/folder").read("site")) == received


def test_of_each_key_the_newest_two_stay(tmp_path: Path) -> None:
    for payload in (b"1", b"2", b"3", b"1"):  # a process each
        LatchedCache(tmp_path).put(model("hall", payload))
    LatchedCache(tmp_path).put(model("room", b"1"))
    assert [(one.key, one.payload) for one in LatchedCache(tmp_path).read("site")] == [
        ("site/model/hall", b"3"),
        ("site/model/hall", b"1"),
        ("site/model/room", b"1"),
    ]
    assert len(list(tmp_path.iterdir())) == 3


def test_what_comes_from_the_cache_is_not_written_again(tmp_path: Path) -> None:
    """A process that ended between two of them would leave the older one as the newest."""
    for payload in (b"1", b"2"):
        LatchedCache(tmp_path).put(model("hall", payload))
    files = sorted(tmp_path.iterdir())
    again = LatchedCache(tmp_path)
    for sample in list(again.read("site")):
        again.put(sample)
        assert sorted(tmp_path.iterdir()) == files
    again.put(model("hall", b"1"))  # the site has gone back to it
    assert [one.payload for one in LatchedCache(tmp_path).read("site")] == [b"2", b"1"]


def test_what_is_damaged_or_foreign_is_passed_over(tmp_path: Path) -> None:
    LatchedCache(tmp_path).put(model("hall", b"1" * 100))
    LatchedCache(tmp_path).put(model("room", b"2"))
    (first, _) = sorted(tmp_path.iterdir())
    first.write_bytes(first.read_bytes()[:-1])
    (tmp_path / "partial-service").write_bytes(b"half")
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / first.name.replace("site", "elsewhere%2Fsite")).write_bytes(b"x\n")
    assert [one.payload for one in LatchedCache(tmp_path).read("site")] == [b"2"]
    assert (tmp_path / "notes.txt").exists()


def test_what_is_damaged_is_written_again_once_it_is_received(tmp_path: Path) -> None:
    LatchedCache(tmp_path).put(model("hall", b"1" * 100))
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-1])
    cache = LatchedCache(tmp_path)
    assert not list(cache.read("site"))
    cache.put(model("hall", b"1" * 100))
    assert [one.payload for one in LatchedCache(tmp_path).read("site")] == [b"1" * 100]


def test_a_service_reads_its_own_channels_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker lives on the list of models; the models may be 600 MB."""
    LatchedCache(tmp_path).put(model("hall", b"1"))
    LatchedCache(tmp_path).put(Arrival(MODEL_SET, "site/models", b"2", encoding(MODEL_SET)))
    opened = list[str]()
    whole = Path.read_bytes

    def read(path: Path) -> bytes:
        opened.append(path.name)
        return whole(path)

    monkeypatch.setattr(Path, "read_bytes", read)
    assert [one.payload for one in LatchedCache(tmp_path).read("site", [MODEL_SET])] == [b"2"]
    assert len(opened) == 1


def test_a_full_disk_leaves_no_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        LatchedCache(tmp_path).put(model("hall", b"1"))
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_read_is_passed_over(tmp_path: Path) -> None:
    """As on a disk with bad blocks: a service that ended at that would end at each start."""
    for region in ("hall", "room"):
        LatchedCache(tmp_path).put(model(region, b"1"))
    (first, _) = sorted(tmp_path.iterdir())
    first.unlink()
    first.mkdir()
    assert [one.key for one in LatchedCache(tmp_path).read("site")] == ["site/model/room"]


def test_a_robot_that_came_from_another_site_does_not_take_its_models_for_this_ones(tmp_path: Path) -> None:
    LatchedCache(tmp_path).put(model("hall", b"1"))
    assert not list(LatchedCache(tmp_path).read("other"))


def test_a_folder_that_cannot_be_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        LatchedCache(tmp_path / "file")


def test_two_failed_starts_set_all_aside_and_one_does_not(tmp_path: Path) -> None:
    LatchedCache(tmp_path).put(model("hall", b"1"))
    (tmp_path / "tables").mkdir()  # what was made of the models goes with them
    for _ in range(3):  # a proven start between two failed ones
        assert not LatchedCache(tmp_path).try_out()
        assert not LatchedCache(tmp_path).try_out()
        LatchedCache(tmp_path).prove()
    for _ in range(2):
        assert not LatchedCache(tmp_path).try_out()
    last = LatchedCache(tmp_path)
    assert last.try_out()
    assert not list(last.read("site"))
    assert {path.name for path in tmp_path.iterdir()} == {"aside"}
    assert len(list((tmp_path / "aside").iterdir())) == 2
    # the same model from the site is cached again
    last.put(model("hall", b"1"))
    again = LatchedCache(tmp_path)
    assert [one.payload for one in again.read("site")] == [b"1"]
    assert not again.try_out()


def test_services_that_share_a_folder_lose_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new set reaches both at once: one begins to write it while the other does."""
    tracker, projector = (LatchedCache(tmp_path, name) for name in ("tracker", "projector"))
    written = os.fsync

    def meanwhile(number: int) -> None:
        monkeypatch.setattr(os, "fsync", written)
        tracker.put(model("hall", b"1"))
        written(number)

    monkeypatch.setattr(os, "fsync", meanwhile)
    projector.put(model("room", b"2"))
    assert {one.payload for one in LatchedCache(tmp_path).read("site")} == {b"1", b"2"}


def test_a_start_of_two_services_that_share_a_folder_counts_once(tmp_path: Path) -> None:
    LatchedCache(tmp_path).put(model("hall", b"1"))
    for name in ("tracker", "projector") * 2:
        assert not LatchedCache(tmp_path, name).try_out()
    assert LatchedCache(tmp_path, "tracker").try_out()


@pytest.mark.parametrize("content", [b"", b"two", b"\xff"])
def test_a_torn_note_of_starts_counts_as_none(tmp_path: Path, content: bytes) -> None:
    cache = LatchedCache(tmp_path)
    (tmp_path / "starts-service").write_bytes(content)
    assert not cache.try_out()
