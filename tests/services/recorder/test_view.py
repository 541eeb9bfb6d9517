"""`eigenscan view`: a recording drawn again, and served."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import psutil
import pytest
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.rerun_sink import RerunSink
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import POSE
from rerun.chunk import RrdReader

from tests.command import eigenscan
from tests.services.recorder.conftest import PATIENCE_S
from tests.services.recorder.traffic import Site

pytestmark = pytest.mark.slow

EIGENSCAN = [sys.executable, "-m", "eigenscan.cli.main", "view"]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "drive.mcap"
    with RecordingWriter(path) as writer:
        for number, message in enumerate(Site("s", seconds=1.0).messages()):
            writer.write(message, 1_000_000_000 + number * 1_000_000)
    return path


def view(*arguments: object) -> subprocess.CompletedProcess[str]:
    return eigenscan("view", *arguments)


def test_a_recording_becomes_a_picture(recording: Path, tmp_path: Path) -> None:
    result = view(recording, "--rrd", tmp_path / "drive.rrd", "--no-open")
    assert (result.returncode, result.stdout) == (0, f"wrote {tmp_path / 'drive.rrd'}\n"), result.stderr
    drawn = {chunk.entity_path for chunk in RrdReader(str(tmp_path / "drive.rrd")).stream()}
    assert {"/world/map", "/world/robots/r1/tracks", "/belief/r1", "/legend"} <= drawn


def drawn_times(rrd: Path, path: str) -> list[int]:
    """Stamps, ns, at which something is drawn at an entity."""
    chunks = [chunk for chunk in RrdReader(str(rrd)).stream() if chunk.entity_path == path]
    columns = [chunk.to_record_batch().column("time") for chunk in chunks if not chunk.is_static]
    return sorted(value.value for column in columns for value in column)


def test_it_begins_where_it_is_asked_to_and_knows_the_map_there(tmp_path: Path) -> None:
    path, messages = tmp_path / "long.mcap", list(Site("s", seconds=6.0).messages())
    first = min(m.stamp for m in messages if m.channel is POSE)
    with RecordingWriter(path) as writer:
        for message in messages:
            writer.write(message, first if message.channel.qos.latched else max(first, message.stamp))
    result = view(path, "--at", 2, "--to", 4, "--rrd", tmp_path / "part.rrd", "--no-open")
    assert result.returncode == 0, result.stderr
    times = drawn_times(tmp_path / "part.rrd", "/world/robots/r1/tracks")
    assert 2.0 <= (times[0] - first) * 1e-9 <= 2.3
    assert 3.7 <= (times[-1] - first) * 1e-9 <= 4.0
    assert "/world/map" in {chunk.entity_path for chunk in RrdReader(str(tmp_path / "part.rrd")).stream()}


def test_a_time_of_day_is_a_moment_as_well(tmp_path: Path) -> None:
    """Of a recording that goes over midnight: 00:00:01 is in it, 22:00 is not."""
    path, messages = tmp_path / "night.mcap", list(Site("s", seconds=4.0).messages())
    midnight = 20_000 * 86_400 * 10**9
    with RecordingWriter(path) as writer:
        for number, message in enumerate(messages):
            writer.write(message, midnight - 10**9 + number * 4 * 10**9 // len(messages))
    arguments = ["--rrd", tmp_path / "part.rrd", "--no-open", "--json", "-"]
    result = view(path, "--at", "00:00:01", "--to", "0:00:02", *arguments)
    assert result.returncode == 0, result.stderr
    figures = json.loads(result.stdout)
    assert (figures["begin_s"], figures["end_s"]) == pytest.approx((2.0, 3.0))
    result = view(path, "--at", "22:00", *arguments)
    assert result.returncode == 2
    assert "night.mcap is from 2024-10-03 23:59:59 to 00:00:0" in result.stderr
    result = view(path, "--at", "3", "--to", "2", *arguments)
    assert result.returncode == 2
    assert "--to: must be after --at" in result.stderr


def test_a_recording_of_one_moment_is_drawn(tmp_path: Path) -> None:
    """Of a converter that knows no log time: it named --to, which nobody had given."""
    with RecordingWriter(tmp_path / "zero.mcap") as writer:
        for message in Site("s", seconds=1.0).messages():
            writer.write(message, 0)
    result = view(tmp_path / "zero.mcap", "--rrd", tmp_path / "zero.rrd", "--no-open")
    assert result.returncode == 0, result.stderr
    assert drawn_times(tmp_path / "zero.rrd", "/world/robots/r1/tracks")


def test_robots_share_one_map(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    both = [m for robot in ("r1", "r2") for m in Site("s", robot, seconds=1.0).messages()]
    with RecordingWriter(path) as writer:
        for number, message in enumerate(both):
            writer.write(message, number)
    assert view(path, "--rrd", tmp_path / "two.rrd", "--no-open").returncode == 0
    drawn = [chunk.entity_path for chunk in RrdReader(str(tmp_path / "two.rrd")).stream()]
    assert {"/world/robots/r1/tracks", "/world/robots/r2/tracks", "/world/map"} <= set(drawn)
    assert {path for path in drawn if path.endswith("/map")} == {"/world/map"}


def test_a_recording_that_was_cut_off_is_drawn_as_far_as_it_goes(recording: Path, tmp_path: Path) -> None:
    recording.write_bytes(recording.read_bytes()[:-200])
    result = view(recording, "--rrd", tmp_path / "drive.rrd", "--no-open")
    assert result.returncode == 0
    assert "did not close it" in result.stderr
    drawn = {chunk.entity_path for chunk in RrdReader(str(tmp_path / "drive.rrd")).stream()}
    assert "/world/robots/r1/tracks" in drawn


@pytest.mark.parametrize(
    ("content", "arguments", "words"),
    [
        (None, ["--rrd", "a.rrd", "--no-open"], "cannot be read"),
        (b"no MCAP", ["--rrd", "a.rrd", "--no-open"], "is no readable recording"),
        (b"", ["--no-open"], "give --rrd"),
        (b"", ["--at", "soon"], "give s from the recording's start, or UTC as 03:12"),
    ],
)
def test_what_cannot_be_drawn_is_reported_in_one_line(
    tmp_path: Path, content: bytes | None, arguments: list[str], words: str
) -> None:
    file = tmp_path / "x.mcap"
    if content is not None:
        file.write_bytes(content)
    result = view(file, *(str(tmp_path / a) if a.endswith(".rrd") else a for a in arguments))
    assert result.returncode == 2
    assert words in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert not (tmp_path / "a.rrd").exists()


def test_a_viewer_whose_server_has_ended_is_reported(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder's health was OK, and `view` waited on, behind a dead link."""

    def servers(parent: int) -> list[psutil.Process]:
        # this process may have other children, such as Python's resource tracker
        return [each for each in psutil.Process(parent).children() if "--serve-web" in each.cmdline()]

    def end_server(parent: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while not (found := servers(parent)):
            assert time.monotonic() < deadline
            time.sleep(0.05)
        found[0].kill()

    sink = RerunSink(RecorderOptions(viewer_port=0, data_port=0))
    assert sink.problem == ""
    end_server(os.getpid())
    deadline = time.monotonic() + PATIENCE_S
    while not sink.problem:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert sink.problem == "viewer: its server ended with code -9: start it again"
    sink.close()

    monkeypatch.setenv("BROWSER", "true")  # the command that webbrowser calls
    with subprocess.Popen(
        [*EIGENSCAN, str(recording)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("viewer: ")
        end_server(process.pid)
        assert "its server ended" in process.communicate(timeout=PATIENCE_S)[1]
        assert process.returncode == 1


def test_the_viewer_is_served_on_this_machine_only_and_ends_with_the_command(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BROWSER", "true")  # the command that webbrowser calls
    with subprocess.Popen(
        [*EIGENSCAN, str(recording)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        link = re.match(r"viewer: (http://127\.0\.0\.1:\d+/)\?url=rerun", process.stdout.readline())
        assert link
        page = ""
        deadline = time.monotonic() + PATIENCE_S
        while "rerun" not in page.lower():
            assert time.monotonic() < deadline
            try:
                with urllib.request.urlopen(link.group(1), timeout=PATIENCE_S) as answer:
                    page = answer.read().decode()
            except OSError:
                time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(link.group(1), timeout=PATIENCE_S)


def test_two_sites_are_not_drawn_over_each_other(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    with RecordingWriter(path) as writer:
        for site in "ab":
            writer.write(next(iter(Site(site, seconds=1.0).messages())), 1)
    result = view(path, "--rrd", tmp_path / "two.rrd", "--no-open")
    assert result.returncode == 2
    assert "two.mcap: holds the sites a, b: give the files of one" in result.stderr
    assert list(tmp_path.iterdir()) == [path]
