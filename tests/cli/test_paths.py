"""What a clumsy user names: an output that is an input too, a file without an end, a disk that is full."""

import io
import json
import os
import resource
import shlex
from pathlib import Path

import pytest
from eigenscan.cli import view
from eigenscan.cli.figures import prepare
from eigenscan.cli.main import app
from eigenscan.recorder.rerun_sink import RerunSink
from eigenscan.runtime.errors import UsageError
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.runtime.session import open_session
from eigenscan.schemas.channels import ContractError
from eigenscan.workbench.playback.controls import Script
from typer.testing import CliRunner

from tests.command import eigenscan


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording, a link to it, a map, and a file that never ends."""
    monkeypatch.chdir(tmp_path)
    made = eigenscan("simulate", "-o", "drive.mcap", "--save-map", "map.yaml", "--seconds", 1)
    assert made.returncode == 0, made.stderr
    Path("link.mcap").hardlink_to("drive.mcap")
    Path("truth.tum").write_text("1 0 0 0 0 0 0 1\n")
    os.mkfifo("endless")
    return tmp_path


@pytest.mark.parametrize(
    ("typed", "option", "kept"),
    [
        ("import drive.mcap -o a.mcap --json drive.mcap", "--json drive.mcap", "drive.mcap"),
        ("import drive.mcap -o a.mcap --json a.mcap", "--json a.mcap", "drive.mcap"),
        ("build map.yaml -o model --json map.yaml", "--json map.yaml", "map.yaml"),
        ("view drive.mcap --no-open --rrd drive.mcap", "--rrd drive.mcap", "drive.mcap"),
        ("view drive.mcap --no-open --rrd link.mcap", "--rrd link.mcap", "drive.mcap"),
        ("simulate map.yaml -o map.yaml --seconds 1", "--out map.yaml", "map.yaml"),
        ("simulate -o a.mcap --truth a.mcap --seconds 1", "--out a.mcap", "map.yaml"),
        ("simulate map.yaml -o map.pgm --seconds 1", "--out map.pgm", "map.pgm"),
        (
            "simulate --truth a.tum --robots 2 --json a-robot1.tum --seconds 1",
            "--truth a.tum: a-robot1.tum would overwrite",
            "map.yaml",
        ),
        ("map drive.mcap -o new.yaml --json new.tum", "-o new.yaml: would overwrite new.tum", "map.yaml"),
        (
            "evaluate drive.mcap map.yaml --save-poses truth.tum --ground-truth truth.tum",
            "truth",
            "truth.tum",
        ),
        ("replay drive.mcap --service scan-ingest --out drive.mcap", "--out drive.mcap", "drive.mcap"),
    ],
)
def test_what_is_read_is_not_written_over(folder: Path, typed: str, option: str, kept: str) -> None:
    before = (folder / kept).read_bytes()
    result = eigenscan(*shlex.split(typed))
    assert result.returncode == 2, result.stderr
    assert option in result.stderr
    assert "name another file" in result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert (folder / kept).read_bytes() == before


@pytest.mark.parametrize("endless", ["endless", "/dev/zero"])
@pytest.mark.parametrize(
    "typed",
    [
        "import {} -o a.mcap",
        "view {} --no-open --rrd a.rrd",
        "repair {}",
        "build map.yaml -o model --regions {}",
        "evaluate drive.mcap map.yaml --ground-truth {}",
        "run map.yaml --zenoh {}",
    ],
)
def test_a_file_without_an_end_is_refused_at_once(folder: Path, typed: str, endless: str) -> None:
    result = eigenscan(*shlex.split(typed.format(endless)))
    assert result.returncode == 2, result.stderr
    assert f"{endless}: is no file that can be read to its end" in result.stderr


def test_a_device_is_not_replaced_by_a_recording(folder: Path) -> None:
    result = eigenscan("import", "drive.mcap", "-o", "endless", "--force")
    assert result.returncode == 2
    assert "-o endless: is no file" in result.stderr
    assert (folder / "endless").is_fifo()


@pytest.mark.parametrize("linked", [False, True])
def test_a_command_that_ends_early_leaves_no_empty_figures(tmp_path: Path, linked: bool) -> None:
    """After Ctrl-C an empty file looked like figures."""
    file, old = tmp_path / "new" / "figures.json", tmp_path / "old.json"
    old.write_text("{}")
    if linked:
        file.parent.mkdir()
        file.symlink_to("elsewhere.json")
    prepare(file)
    prepare(old)
    assert [one for one in file.parent.iterdir() if not one.is_symlink()] == []
    assert file.is_symlink() == linked
    assert old.read_text() == "{}"


def test_a_figures_file_may_be_a_device(folder: Path) -> None:
    assert (folder / "drive.mcap").exists()
    assert eigenscan("import", "drive.mcap", "-o", "a.mcap", "--json", "/dev/null").returncode == 0


@pytest.mark.parametrize(
    ("typed", "place"),
    [
        ("replay drive.mcap --service scan-ingest --out /dev/full", "--out /dev/full"),
        ("import drive.mcap -o a.mcap --json /dev/full", "--json /dev/full"),
        ("simulate -o /dev/full --seconds 5", "--out /dev/full"),
    ],
)
def test_a_full_disk_is_named_by_what_is_written(folder: Path, typed: str, place: str) -> None:
    result = eigenscan(*shlex.split(typed), cwd=folder)
    assert result.returncode == 2, result.stderr
    assert place in result.stderr
    assert "No space left on device: make room" in result.stderr


def test_a_picture_on_a_full_disk(folder: Path) -> None:
    assert (folder / "drive.mcap").exists()
    result = eigenscan("view", "drive.mcap", "--no-open", "--rrd", "/dev/full")
    assert result.returncode == 2
    assert "view: /dev/full: No space left on device: make room" in result.stderr


def test_a_picture_that_outgrows_the_limit_on_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun's words alone were shown, as for a quota that is used up."""

    def end_early(*_: object) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    monkeypatch.setattr(RerunSink, "write", end_early)
    typed = ["view", str(folder / "drive.mcap"), "--no-open", "--rrd", str(folder / "a.rrd")]
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (view.LEAST_FREE // 2, usual[1]))
    try:
        result = CliRunner().invoke(app, typed)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, usual)
    assert result.exit_code == 2
    assert f"{folder / 'a.rrd'}: File too large: raise the limit (ulimit -f)" in result.stderr
    result = CliRunner().invoke(app, typed)
    assert result.exit_code == 1
    assert "prematurely" in result.stderr


def test_a_report_is_shown_before_its_figures_fill_the_disk(folder: Path) -> None:
    """Half an hour of work was lost."""
    made = eigenscan("simulate", "-o", "long.mcap", "--truth", "long.tum", "--seconds", 20)
    assert made.returncode == 0, made.stderr
    stamps = [line.split()[0] for line in (folder / "long.tum").read_text().splitlines()]
    lines = ["stamp,x,y,heading", *(f"{stamp},0,0,0" for stamp in stamps)]
    (folder / "claims.csv").write_text("\n".join(lines) + "\n")
    typed = shlex.split("evaluate long.mcap --poses claims.csv --ground-truth long.tum")
    shown = eigenscan(*typed, cwd=folder)
    result = eigenscan(*typed, "--json", "/dev/full", cwd=folder)
    assert (shown.returncode, result.returncode) == (0, 2), shown.stderr
    assert "--json /dev/full: No space left on device" in result.stderr
    assert result.stdout == shown.stdout != ""


def test_a_name_that_is_no_utf8(folder: Path) -> None:
    odd = os.fsdecode(b"[red]dr\xffve.mcap")
    (folder / "drive.mcap").rename(folder / odd)
    result = eigenscan("import", odd, "-o", os.fsdecode(b"\xfe.mcap"), "--json", "figures.json")
    assert result.returncode == 0, result.stderr
    assert "[red]dr?ve.mcap" in result.stdout
    assert os.fsencode(json.loads((folder / "figures.json").read_text())["recording"]) == b"\xfe.mcap"


def test_a_link_to_itself_is_no_fault_of_ours(folder: Path) -> None:
    (folder / "loop.bag").symlink_to("loop.bag")
    result = eigenscan("import", "loop.bag")
    assert result.returncode == 2, result.stderr
    assert "loop.bag: cannot be read" in result.stderr


def test_more_pictures_than_can_be_drawn(folder: Path) -> None:
    result = eigenscan("view", folder / "drive.mcap", "--picture-hz", 1e300)
    assert result.returncode == 2, result.stderr
    assert "--picture-hz" in result.stderr


@pytest.mark.parametrize(
    ("typed", "words"),
    [
        ("conform tracker --junit . -- none", "--junit .: is a folder: name a file in it"),
        ("simulate -o a.mcap --truth . --seconds 1", "--truth .: is a folder: name a file in it"),
        ("import drive.mcap -o a.mcap --mount front=1e308,0,0", "--mount front=1e308,0,0: is farther than"),
        ("import drive.mcap -o a.mcap --site a/b", "--site 'a/b': a name has no blanks"),
        ("import drive.mcap -o a.mcap --robot 'r 1'", "--robot 'r 1': a name has no blanks"),
        ("simulate --save-map new.yaml --live --robot a/b", "--robot 'a/b': a name has no blanks"),
        ("play drive.mcap --wait 0 --site a/b", "--site 'a/b': a name has no blanks"),
        ("simtest --robots 100000", "less than or equal to 100"),
        ("simulate -o a.mcap --seconds inf", "--seconds"),
        ("simulate -o a.mcap --seconds 1 --speed 2", "--speed 2: give --live as well"),
        ("evaluate drive.mcap --poses truth.tum --spacing 0.2", "--spacing: has no effect with --poses"),
        ("evaluate drive.mcap --save-runs runs --skip windows", "--skip: has no effect with --save-runs"),
        ("repair .", ".: is a folder: name one of its recordings"),
        ("doctor --json map.yaml/a.json", "map.yaml"),
        ("models list . --json map.yaml/a.json", "map.yaml"),
        ("fleet status --once --json map.yaml/a.json", "map.yaml"),
        ("fleet relocate r1 --search --json map.yaml/a.json", "map.yaml"),
        ("play drive.mcap --wait 0 --from 1e308", "--from"),
        ("play drive.mcap --wait 0 --robots 1000000000", "--robots"),
        ("view drive.mcap --no-open --rrd a.mcap --at 1e308", "--at"),
        ("doctor --seconds inf", "--seconds"),
        ("fleet status --once --seconds inf", "--seconds"),
        ("fleet fetch r1 --from 1m --seconds inf", "--seconds"),
        ("fleet fetch r1 --from 1m --out map.yaml", "--out map.yaml: is no folder: name one"),
        (f"fleet fetch r1 --from {'9' * 400}h", "--from"),
        ("fleet relocate r1 --search --seconds 1e308", "--seconds"),
        ("simulate -o a.mcap --seconds 1e300", "--seconds"),
        ("simulate -o a.mcap --seconds 1 --people 1000000000", "--people"),
        ("simulate -o a.mcap --seconds 1 --robots 100000", "--robots"),
        ("simulate -o a.mcap --seconds 1 --beams 1000000000", "--beams"),
        ("simulate -o a.mcap --seconds 1 --drift inf", "--drift"),
        ("simulate -o a.mcap --seconds 1 --noise 1e308", "--noise"),
        ("simulate -o a.mcap --seconds 1 --save-map new.pgm", "--save-map new.pgm: the image goes there"),
        ("simulate map.yaml --seconds 1 --save-map other.pgm", "--save-map other.pgm: the image goes there"),
        ("simulate -o map.pgm --seconds 1 --save-map map.yml", "map.pgm would overwrite map.pgm"),
    ],
)
def test_what_cannot_be_is_refused_before_the_work(folder: Path, typed: str, words: str) -> None:
    result = eigenscan(*shlex.split(typed))
    assert result.returncode == 2, result.stderr
    assert words in result.stderr
    assert not result.stdout
    assert not (folder / "a.mcap").exists()


@pytest.mark.parametrize("name", ["out.yaml", "out.pgm", "out.tum", "out.png"])
def test_a_map_replaces_none_of_its_four_files_unasked(folder: Path, name: str) -> None:
    (folder / name).write_text("mine")
    result = eigenscan("map", "drive.mcap", "-o", "out.yaml")
    assert result.returncode == 2, result.stderr
    assert f"{name} is there already: name another file, or add --force" in result.stderr
    assert (folder / name).read_text() == "mine"


def test_a_saved_map_replaces_no_image_of_something_else(folder: Path) -> None:
    (folder / "plan.pgm").write_text("mine")
    result = eigenscan("simulate", "--seconds", 1, "--save-map", "plan.yaml")
    assert result.returncode == 2, result.stderr
    assert "--save-map plan.yaml: plan.pgm is there already: name another file" in result.stderr
    assert (folder / "plan.pgm").read_text() == "mine"
    assert eigenscan("simulate", "--seconds", 1, "--save-map", "map.yaml").returncode == 0


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize(
    ("typed", "option"),
    [
        ("simulate --seconds 1 -o night.mcap", "--out night.mcap"),
        ("replay drive.mcap --service scan-ingest --out night.mcap", "--out night.mcap"),
        ("view drive.mcap --no-open --rrd night.mcap", "--rrd night.mcap"),
        ("simulate --seconds 1 --truth night.mcap", "--truth night.mcap"),
    ],
)
def test_what_a_recorder_wrote_is_not_replaced(folder: Path, typed: str, option: str, cut: bool) -> None:
    night = folder / "night.mcap"
    with RecordingWriter(night, {"recorder": {"settings": "{}"}}):
        pass
    if cut:
        night.write_bytes(night.read_bytes()[:100])
    before = night.read_bytes()
    result = eigenscan(*shlex.split(typed))
    assert result.returncode == 2, result.stderr
    assert f"{option}: is a recorder's file: name another one" in result.stderr
    assert night.read_bytes() == before


def test_what_a_simulation_wrote_may_be_written_again(folder: Path) -> None:
    assert eigenscan("simulate", "--seconds", 1, "-o", "drive.mcap").returncode == 0
    assert (folder / "drive.mcap").exists()


def test_a_recording_cut_before_its_first_chunk_holds_nothing_to_play(folder: Path) -> None:
    """It was said to last -18446744073.7 s."""
    (folder / "cut.mcap").write_bytes((folder / "drive.mcap").read_bytes()[:2000])
    result = eigenscan("play", "cut.mcap", "--wait", 0)
    assert result.returncode == 2, result.stderr
    assert "cut.mcap: holds no message: it ends before the first whole chunk" in result.stderr


@pytest.mark.parametrize("line", ["seek 1e308", "skip -1e308", "seek nan", "skip inf"])
def test_a_seek_that_no_stamp_can_count_is_no_command(line: str) -> None:
    with pytest.raises(UsageError, match="is no command"):
        Script(io.StringIO(line)).wait(5.0)


def test_an_endpoint_that_is_none_is_named() -> None:
    with pytest.raises(ContractError, match=r"^--listen nonsense: .*<protocol>/<address>"):
        open_session(None, listen=["nonsense"])
