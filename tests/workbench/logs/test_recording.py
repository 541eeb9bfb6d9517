from __future__ import annotations

from pathlib import Path

import pytest
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import HEALTH, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.logs import LogError, LogOptions, open_log
from eigenscan.workbench.logs.log import odometry, raw_scan
from eigenscan.workbench.logs.scans import read_scans
from mcap.reader import make_reader

S = 1_000_000_000


def scan(time: float, robot: str = "robot", lidar: str = "front") -> Envelope:
    return raw_scan(
        LogOptions(robot=robot), lidar, round(time * S), (0.1, 0, 0), ranges=[time] * 50, angle_increment=0.02
    )


def moved(time: float, robot: str = "robot") -> Envelope:
    return odometry(LogOptions(robot=robot), round(time * S), (time, 0, 0))


def record(path: Path, envelopes: list[Envelope], delay: float = 0.0) -> Path:
    with RecordingWriter(path) as writer:
        for envelope in envelopes:
            writer.write(envelope, envelope.stamp + round(delay * S))
            writer.flush()
    return path


def keys(path: Path, **options: object) -> list[tuple[str, float]]:
    log = open_log(path, LogOptions(**options))  # type: ignore[arg-type]
    return [(envelope.key, envelope.stamp / S) for envelope in log.envelopes()]


def test_scans_and_odometry_come_back_as_they_were(tmp_path: Path) -> None:
    published = [moved(1), scan(1), moved(2), scan(2), scan(2.5, lidar="rear")]
    health = Envelope(HEALTH, {"site": "site", "service": "tracker", "instance": "0"}, Health())
    health.message.timestamp.FromNanoseconds(S)  # type: ignore[attr-defined]
    log = open_log(record(tmp_path / "a.mcap", [*published, health]))
    received = list(log.envelopes())
    assert [(e.key, e.message) for e in received] == [(e.key, e.message) for e in published]
    assert log.format == "Eigenscan recording"
    # a second time, too
    assert len(list(log.envelopes())) == len(received)


def test_the_mapbuilder_reads_a_log_once_and_keeps_its_messages_on_request(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", published := [moved(1), scan(1), moved(2), scan(2)])
    received = list[Envelope]()
    scans = read_scans(path, LogOptions(), lambda _: None, received=received)
    assert [(e.key, e.message) for e in received] == [(e.key, e.message) for e in published]
    assert len(scans.sweeps) == scans.received == 2


def test_what_was_recorded_late_is_put_in_order(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for time, logged in ((1.0, 1.1), (1.2, 1.9), (1.4, 1.5), (2.0, 2.1)):
            writer.write(scan(time), round(logged * S))
        writer.write(moved(1.2), round(2.2 * S))
    assert [time for _, time in keys(tmp_path / "a.mcap")] == [1.0, 1.2, 1.2, 1.4, 2.0]


def test_one_robot_is_chosen(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(1, "a"), scan(1, "b"), moved(2, "b"), scan(2, "b")])
    with pytest.raises(LogError, match=r"a\.mcap: holds scans of a, b: choose one as robot"):
        keys(path)
    assert keys(path, robot="b", site="lab") == [
        ("lab/robot/b/scan/raw/front", 1.0),
        ("lab/robot/b/odom", 2.0),
        ("lab/robot/b/scan/raw/front", 2.0),
    ]


def test_the_only_robot_goes_by_the_usual_name(tmp_path: Path) -> None:
    assert keys(record(tmp_path / "a.mcap", [scan(1, "r17")])) == [("site/robot/robot/scan/raw/front", 1.0)]
    with pytest.raises(LogError, match=r"holds scans of r17: choose"):
        keys(tmp_path / "a.mcap", robot="r18")


def test_a_lidar_is_chosen(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(1), scan(1.5, lidar="rear"), moved(2)])
    assert [key for key, _ in keys(path, lidars=("rear",))] == [
        "site/robot/robot/scan/raw/rear",
        "site/robot/robot/odom",
    ]


def test_a_recording_that_was_cut_gives_what_is_whole(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    log = open_log(path)
    assert 10 < sum(e.channel is SCAN_RAW for e in log.envelopes()) < 199
    assert log.counters["truncated_file"] == 1


def test_a_damaged_recording_gives_what_comes_before(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 200] = bytes(200)
    path.write_bytes(bytes(data))
    log = open_log(path)
    assert 10 < sum(e.channel is SCAN_RAW for e in log.envelopes()) < 199
    assert log.counters["damaged_file"] == 1


def damage_chunk(path: Path, number: int) -> None:
    """Zeros within one chunk; what comes before it can be read."""
    data = bytearray(path.read_bytes())
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunk = sorted(index.chunk_start_offset for index in summary.chunk_indexes)[number]
    data[chunk + 70 : chunk + 90] = bytes(20)
    path.write_bytes(bytes(data))


def test_the_remark_names_what_was_read_and_what_saves_the_rest(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    damage_chunk(path, 50)
    log = open_log(path)
    assert len(list(log.envelopes())) == 50
    assert f"eigenscan repair {path} saves what can be read" in log.damage
    assert log.damage.endswith("; only the first 25% of its messages were read")


def test_damage_before_any_scan_is_the_error(tmp_path: Path) -> None:
    health = Envelope(HEALTH, {"site": "site", "service": "tracker", "instance": "0"}, Health())
    health.message.timestamp.FromNanoseconds(S)  # type: ignore[attr-defined]
    path = record(tmp_path / "a.mcap", [health, *(scan(n) for n in range(2, 200))])
    damage_chunk(path, 1)
    with pytest.raises(LogError, match=r"is damaged \(.*eigenscan repair .* only the first 1% of"):
        keys(path)


def test_damage_to_the_head_of_a_chunk_gives_what_comes_before(tmp_path: Path) -> None:
    """It then states sizes to which some file systems refuse to seek: ext4 ends at 2^44 bytes."""
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    whole = path.read_bytes()
    for begin in range(len(whole) // 3, len(whole) // 2, 61):  # a chunk has about 140 bytes
        path.write_bytes(whole[:begin] + bytes(200) + whole[begin + 200 :])
        log = open_log(path)
        assert 10 < sum(e.channel is SCAN_RAW for e in log.envelopes()) < 199
        assert log.counters["damaged_file"] == 1


def test_a_chunk_that_states_no_size_loses_no_message(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    whole = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    chunks = sorted(index.chunk_start_offset for index in summary.chunk_indexes)
    damaged = whole[: chunks[20] + 1] + bytes(8) + whole[chunks[20] + 9 :]
    for data, messages in ((damaged, 199), (damaged[: chunks[100]], 100)):
        path.write_bytes(data)
        assert sum(e.channel is SCAN_RAW for e in open_log(path).envelopes()) == messages


def test_damage_to_the_index_loses_no_message(tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", [scan(n) for n in range(1, 200)])
    whole = path.read_bytes()
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    last = max(index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes)
    for begin in range(last + 200, len(whole) - 208, 997):
        path.write_bytes(whole[:begin] + bytes(200) + whole[begin + 200 :])
        assert sum(e.channel is SCAN_RAW for e in open_log(path).envelopes()) == 199


def test_a_recording_without_scans_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: holds no raw scan"):
        keys(record(tmp_path / "a.mcap", [moved(1)]))


def test_a_lidar_that_is_not_there_is_refused(tmp_path: Path) -> None:
    """The library gave an empty list."""
    path = record(tmp_path / "a.mcap", [scan(1), scan(1, "robot", "left")])
    with pytest.raises(LogError, match=r"a\.mcap: no lidar rear: choose one of front, left"):
        keys(path, lidars=("front", "rear"))


def test_stamps_as_logged_survive_an_import(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap", {"import": {"source": "a.clf"}}) as writer:
        writer.write(scan(1), S)
        writer.write(scan(2), 2 * S, publish_time=9 * S)
    log = open_log(tmp_path / "a.mcap")
    assert [e.open(RawScan).ranges[0] for e in log.envelopes() if e.channel is not ODOMETRY] == [1.0, 2.0]
    assert log.logged == {2 * S: 9 * S}


def test_a_recorders_folder_of_files_is_one_log(tmp_path: Path) -> None:
    first, second = [moved(1), scan(1)], [moved(2), scan(2)]
    record(tmp_path / "a.mcap", first)
    record(tmp_path / "b.mcap", second)
    (tmp_path / "c.mcap").write_bytes((tmp_path / "b.mcap").read_bytes()[:7])  # only begun
    log = open_log(tmp_path)
    received = list(log.envelopes())
    assert [(e.key, e.stamp) for e in received] == [(e.key, e.stamp) for e in (*first, *second)]
    assert log.format == "Eigenscan recording"
    assert log.progress == 1.0
    assert not log.counters["truncated_file"]


def test_robots_of_one_name_at_two_sites_are_not_mixed(tmp_path: Path) -> None:
    sites = [raw_scan(LogOptions(site=site), "front", S, (0, 0, 0), ranges=[1.0] * 9) for site in "ab"]
    path = record(tmp_path / "two.mcap", sites)
    with pytest.raises(LogError, match=r"two\.mcap: holds a robot of each of the sites a, b: give the files"):
        keys(path)
