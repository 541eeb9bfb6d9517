"""A robot's recordings brought to the site: who asks and who answers, without a network between."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from eigenscan.cli.moment import instant
from eigenscan.fleet import fetch as fetching
from eigenscan.fleet.fetch import Ask, fetch, missing_bytes, parts_within
from eigenscan.recorder.files import Files
from eigenscan.recorder.uploads import Uploads
from eigenscan.runtime.errors import FailedError, UsageError
from eigenscan.runtime.recording import RecordingWriter, is_complete, read
from eigenscan.schemas.channels import MOST_RECORDED_BYTES, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.recordings_pb2 import RecordingPart, RecordingParts, RecordingRequest
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

S = 1_000_000_000
BEGIN = 1_700_000_000 * S
ADDRESS = {"site": "s", "robot": "r17"}
PIECE = 5_000
assert fetching.PIECE_BYTES <= MOST_RECORDED_BYTES  # or no fetch would ever get what it asks for


@pytest.fixture(autouse=True)
def _small_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetching, "PIECE_BYTES", PIECE)
    monkeypatch.setattr(fetching, "OVERLAP_BYTES", 500)


def write(writer: RecordingWriter, seconds: range) -> None:
    for second in seconds:
        at = BEGIN + second * S
        pose = PoseEstimate(timestamp=stamp(at), model_version=f"{second * 7919:064x}")
        writer.write(Envelope(POSE, ADDRESS, pose), at)
        if second % 50 == 0:
            writer.flush()
    writer.flush()


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    """A robot's folder: two files that were closed, ten minutes each, and one that is not."""
    folder = tmp_path / "robot"
    for number in range(2):
        with RecordingWriter(folder / f"s-20231114-22130{number}.mcap") as writer:
            write(writer, range(600 * number, 600 * (number + 1)))
    return folder


@pytest.fixture
def still_written(robot: Path) -> Iterator[RecordingWriter]:
    with RecordingWriter(robot / "s-20231114-221302.mcap") as writer:
        write(writer, range(1200, 1500))
        yield writer


@pytest.fixture
def ask(robot: Path) -> Ask:
    return Uploads(Files(robot, "s")).answer


def after(seconds: float) -> int:
    return BEGIN + int(seconds * S)


def counted(ask: Ask, cut_after: int | None = None) -> tuple[Ask, list[RecordingRequest]]:
    """`ask` over a link that breaks before the piece `cut_after`; what was asked for so far."""
    asked: list[RecordingRequest] = []

    def through(what: str, payload: bytes) -> bytes:
        if what == "bytes":
            if len(asked) == cut_after:
                raise FailedError("r17 did not answer within 10 s")
            asked.append(RecordingRequest.FromString(payload))
        return ask(what, payload)

    return through, asked


def poses(path: Path) -> list[int]:
    return [record.log_time for record in read(path) if record.envelope.channel is POSE]


def test_what_comes_is_what_the_robot_has_and_comes_once(robot: Path, ask: Ask, tmp_path: Path) -> None:
    parts = parts_within(ask, "r17", after(100), after(700))
    assert [part.closed for part in parts] == [True, True]
    assert missing_bytes(parts, tmp_path / "here") == sum(part.size for part in parts)
    for part in parts:
        came = fetch(ask, part, tmp_path / "here")
        assert came.path.read_bytes() == (robot / part.name).read_bytes()
        assert came.bytes_moved == part.size > 3 * PIECE
        assert fetch(ask, part, tmp_path / "here").bytes_moved == 0
    assert missing_bytes(parts, tmp_path / "here") == 0
    assert len(list((tmp_path / "here").iterdir())) == 2
    assert poses(tmp_path / "here") == [after(second) for second in range(1200)]


def test_only_files_of_that_time_come(ask: Ask) -> None:
    assert len(parts_within(ask, "r17", after(0), after(599))) == 1
    assert len(parts_within(ask, "r17", after(599.5), after(600))) == 1
    with pytest.raises(FailedError, match=r"r17 has no recording of that time: it keeps 2023-11-14 22:13:20"):
        parts_within(ask, "r17", after(9_000), after(9_100))


def test_a_fetch_that_was_cut_off_goes_on(robot: Path, ask: Ask, tmp_path: Path) -> None:
    (part,) = parts_within(ask, "r17", after(0), after(10))
    broken, _ = counted(ask, cut_after=2)
    with pytest.raises(FailedError, match=r"r17 did not answer.*0\.0 of 0\.\d MB are here.*goes on"):
        fetch(broken, part, tmp_path)
    assert not (tmp_path / part.name).exists()
    whole, asked = counted(ask)
    assert fetch(whole, part, tmp_path).path.read_bytes() == (robot / part.name).read_bytes()
    assert sum(one.length for one in asked) == part.size - 2 * PIECE + 500
    assert all(one.length <= PIECE for one in asked)


@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(0, 4), max_size=12))
def test_however_often_it_is_cut_off(
    robot: Path, ask: Ask, tmp_path_factory: pytest.TempPathFactory, cuts: list[int]
) -> None:
    here = tmp_path_factory.mktemp("here")
    part = parts_within(ask, "r17", after(0), after(10))[0]
    for cut in cuts:
        through, _ = counted(ask, cut)
        try:
            fetch(through, part, here)
        except FailedError:
            assert not (here / part.name).exists()
    assert fetch(ask, part, here).path.read_bytes() == (robot / part.name).read_bytes()


def test_a_file_that_is_still_written_comes_as_far_as_it_is_and_later_the_rest(
    robot: Path, still_written: RecordingWriter, ask: Ask, tmp_path: Path
) -> None:
    (part,) = parts_within(ask, "r17", after(1200), after(10**9))
    assert not part.closed
    came = fetch(ask, part, tmp_path)
    assert is_complete(came.path)
    assert poses(came.path) == [after(second) for second in range(1200, 1500)]
    write(still_written, range(1500, 1600))
    still_written.close()
    (part,) = parts_within(ask, "r17", after(1200), after(10**9))
    assert part.closed
    through, asked = counted(ask)
    again = fetch(through, part, tmp_path)
    assert again.path.read_bytes() == (robot / part.name).read_bytes()
    assert sum(one.length for one in asked) < part.size / 2
    assert [path.name for path in tmp_path.glob("s-*")] == [part.name]


def test_what_is_written_while_it_comes_does_no_harm(
    robot: Path, still_written: RecordingWriter, ask: Ask, tmp_path: Path
) -> None:
    (part,) = parts_within(ask, "r17", after(1200), after(10**9))
    more = iter(range(1500, 10_000))

    def while_writing(what: str, payload: bytes) -> bytes:
        second = next(more)
        write(still_written, range(second, second + 1))
        return ask(what, payload)

    assert poses(fetch(while_writing, part, tmp_path).path) == [after(one) for one in range(1200, 1500)]


def test_another_file_of_the_same_name_is_started_again(robot: Path, ask: Ask, tmp_path: Path) -> None:
    (part,) = parts_within(ask, "r17", after(0), after(10))
    (tmp_path / f"{part.name}.part").write_bytes(b"x" * (2 * PIECE))
    assert fetch(ask, part, tmp_path).path.read_bytes() == (robot / part.name).read_bytes()


def test_a_file_that_was_deleted_meanwhile_is_reported(robot: Path, ask: Ask, tmp_path: Path) -> None:
    (part,) = parts_within(ask, "r17", after(0), after(10))

    def refused(what: str, payload: bytes) -> bytes:
        try:
            return ask(what, payload)
        except ValueError as error:  # as the network hands it on
            raise FailedError(f"r17: {error}") from error

    (robot / part.name).unlink()
    with pytest.raises(FailedError, match=r"r17: s-20231114-221300\.mcap: is not there .*make room"):
        fetch(refused, part, tmp_path)
    assert list(tmp_path.glob("s-*")) == []


def test_damaged_bytes_are_no_recording(ask: Ask, tmp_path: Path) -> None:
    (part,) = parts_within(ask, "r17", after(0), after(10))
    with pytest.raises(FailedError, match="no whole recording"):
        fetch(lambda _what, payload: bytes(RecordingRequest.FromString(payload).length), part, tmp_path)
    assert list(tmp_path.glob("s-*")) == []


@pytest.mark.parametrize("name", ["../../.bashrc.mcap", "/etc/x.mcap", ".x.mcap", "x.sh", "a/b.mcap", ""])
def test_a_robot_cannot_write_elsewhere(name: str) -> None:
    lie = RecordingParts(parts=[RecordingPart(name=name, size=1, begin_ns=0, end_ns=after(0))])
    with pytest.raises(FailedError, match="do not trust"):
        parts_within(lambda _what, _payload: lie.SerializeToString(), "r17", 0, after(0))


@pytest.mark.parametrize("answer", [b"", b"x" * (PIECE + 1)])
def test_a_robot_that_sends_nothing_or_too_much_ends_it(answer: bytes, tmp_path: Path) -> None:
    part = RecordingPart(name="a.mcap", size=2 * PIECE, closed=True)
    with pytest.raises(FailedError, match=f"{len(answer)} bytes came for {PIECE}"):
        fetch(lambda _what, _payload: answer, part, tmp_path)


def test_a_disk_without_room_is_reported_before_anything_comes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("shutil.disk_usage", lambda _path: type("Usage", (), {"free": 3_000_000}))
    part = RecordingPart(name="a.mcap", size=2_000_000)
    assert missing_bytes([RecordingPart(name="a.mcap", size=2_000_000, closed=True)], tmp_path) == 2_000_000
    with pytest.raises(FailedError, match="3 MB free for 4 MB"):  # it is kept as it came and with an index
        missing_bytes([part], tmp_path / "not/there")


def request(name: str, offset: int = 0, length: int = 100) -> bytes:
    return RecordingRequest(name=name, offset=offset, length=length).SerializeToString()


def test_a_recorder_gives_its_own_files_only_and_not_too_much_at_once(robot: Path, ask: Ask) -> None:
    (robot / "secret.txt").write_text("x")
    (robot / "other-20231114-221300.mcap").write_bytes(b"x")
    (robot.parent / "s-20231114-221300.mcap").write_bytes(b"x")
    for name in ("secret.txt", "other-20231114-221300.mcap", "../s-20231114-221300.mcap", str(robot), ""):
        with pytest.raises(ValueError, match="is not there"):
            ask("bytes", request(name))
    for what, payload in (("all", b""), ("bytes", b"\xff")):
        with pytest.raises(ValueError, match=r"ask for|RecordingRequest"):
            ask(what, payload)
    big = robot / "s-20231114-221309.mcap"
    big.write_bytes(bytes(3 * MOST_RECORDED_BYTES))
    assert len(ask("bytes", request(big.name, length=2**32 - 1))) == MOST_RECORDED_BYTES
    assert ask("bytes", request(big.name, offset=2**63)) == b""


def test_a_listing_reads_a_closed_file_once(robot: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    uploads = Uploads(Files(robot, "s"))
    before = uploads.parts()
    assert len(before.parts) == 2
    monkeypatch.setattr("eigenscan.recorder.uploads.closed_span", None)
    assert uploads.parts() == before


NOW = int(datetime(2026, 1, 31, 3, 15, tzinfo=UTC).timestamp()) * S


@pytest.mark.parametrize(
    ("text", "then"),
    [
        ("now", (31, 3, 15, 0)),
        ("15m", (31, 3, 0, 0)),
        ("1.5h", (31, 1, 45, 0)),
        ("90s", (31, 3, 13, 30)),
        ("1d", (30, 3, 15, 0)),
        ("03:12", (31, 3, 12, 0)),
        ("03:16", (30, 3, 16, 0)),  # it was not yet today
        ("23:59:30", (30, 23, 59, 30)),
        ("2026-01-30T04:00", (30, 4, 0, 0)),
        ("2026-01-30T04:00+02:00", (30, 2, 0, 0)),
        ("2026-01-30 04:00:01", (30, 4, 0, 1)),
    ],
)
def test_times_as_people_write_them(text: str, then: tuple[int, int, int, int]) -> None:
    assert instant("--from", text, NOW) == int(datetime(2026, 1, *then, tzinfo=UTC).timestamp()) * S


@pytest.mark.parametrize("text", ["", "yesterday", "25:00", "15", "-15m", "2026-13-01"])
def test_a_bad_time_is_answered_with_the_option_and_the_forms(text: str) -> None:
    with pytest.raises(UsageError, match=r"--from .*15m"):
        instant("--from", text, NOW)
