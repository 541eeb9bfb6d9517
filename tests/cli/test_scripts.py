"""What scripts rely on: JSON, exit codes, completion, examples that can be typed."""

import json
import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from eigenscan.cli import fleet
from eigenscan.cli.main import COMMANDS, app

from tests.command import eigenscan

pytestmark = pytest.mark.slow

EIGENSCAN = [sys.executable, "-m", "eigenscan.cli.main"]


def _run(*arguments: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return eigenscan(*arguments, cwd=cwd, **environment)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small map and a recording."""
    folder = tmp_path_factory.mktemp("drive")
    made = _run("simulate", "--seconds", 2, "-o", "drive.mcap", "--save-map", "map.yaml", cwd=folder)
    assert made.returncode == 0, made.stderr
    return folder


def _figures(result: subprocess.CompletedProcess[str]) -> Any:
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_a_pipeline_of_json(drive: Path) -> None:
    built = _figures(_run("build", "map.yaml", "-o", "model", "--step", 2, "--json", "-", cwd=drive))
    assert built["free_area_m2"] > 100
    (listed,) = _figures(_run("models", "list", "model", "--json", "-", cwd=drive))
    assert listed["in_use"]
    assert listed["version"] == built["version"]
    imported = _figures(_run("import", "drive.mcap", "-o", "own.mcap", "--json", "-", cwd=drive))
    assert imported["messages"]["front"] == {"count": 20, "seconds": pytest.approx(1.9), "beams": [361]}
    assert _figures(_run("repair", "own.mcap", "--json", "-", cwd=drive)) == {
        "whole": True,
        "recording": "own.mcap",
    }


def test_json_into_a_file_leaves_the_words(drive: Path) -> None:
    result = _run("build", "map.yaml", "-o", "words", "--step", 2, "--json", "new/f.json", cwd=drive)
    assert "free area" in result.stdout
    assert json.loads((drive / "new/f.json").read_text())["regions"] > 1


def test_a_json_file_that_cannot_be_written_is_reported_before_the_work(drive: Path) -> None:
    (drive / "taken").write_text("")
    result = _run("build", "map.yaml", "-o", "never", "--json", "taken/f.json", cwd=drive)
    assert result.returncode == 2
    assert not (drive / "never").exists()


@pytest.mark.parametrize("name", [*COMMANDS, *(f"fleet {name}" for name in fleet.COMMANDS)])
def test_every_example_can_be_typed(name: str) -> None:
    command: Any = typer.main.get_command(app)
    for word in name.split():
        command = command.get_command(None, word)
    lines = [line.strip() for line in (command.help or "").splitlines()]
    examples = [line for line in lines if line.startswith(f"eigenscan {name} ")]
    assert examples or name in ("demo", "fleet")
    for line in examples:
        words = shlex.split(line)[1 + len(name.split()) :]
        command.make_context(name, words).close()


def test_debug_may_come_last(drive: Path) -> None:
    result = _run("build", "absent.yaml", "-o", "model2", "--debug", cwd=drive)
    assert "Traceback" in result.stderr
    assert "MapError" in result.stderr


def test_ctrl_c_is_130(tmp_path: Path) -> None:
    command = [*EIGENSCAN, "simulate", "--live", "--seconds", "60", "--site", f"c{os.getpid()}"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        assert "publishing" in process.stderr.readline()
        process.send_signal(signal.SIGINT)
        assert process.wait(240) == 130


def _interrupted_while_it_loads(before: str) -> subprocess.CompletedProcess[str]:
    code = (
        "import os, signal, sys\n"
        f"{before}\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'eigenscan.cli.command_group':\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.argv = ['eigenscan', '--version']\n"
        "from eigenscan.cli.entry import main; main()"
    )
    return subprocess.run([sys.executable, "-c", code], check=False, capture_output=True, text=True)


def test_ctrl_c_while_it_still_loads_is_130_too() -> None:
    done = _interrupted_while_it_loads("")
    assert (done.returncode, done.stderr) == (130, "eigenscan: ended by Ctrl-C\n")


def test_a_command_in_a_scripts_background_goes_on_at_ctrl_c() -> None:
    """A shell has such a command ignore SIGINT, which is for what runs in front."""
    done = _interrupted_while_it_loads("signal.signal(signal.SIGINT, signal.SIG_IGN)")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "typed",
    [
        "replay drive.mcap --service scan-ingest --out half.mcap",
        "view drive.mcap --no-open --rrd half.rrd",
        "simulate -o half.mcap --seconds 20",
    ],
)
def test_ctrl_c_leaves_no_half_of_an_output(tmp_path: Path, drive: Path, typed: str) -> None:
    """What was written until then had an index, and looked whole."""
    code = (
        "import sys, os, signal\n"
        "from eigenscan.workbench.progress import Bars\n"
        "start = Bars.start_share\n"
        "def begin(self, text):\n"
        "    moved, calls = start(self, text), []\n"
        "    def move(share):\n"
        "        moved(share); calls.append(share)\n"
        "        if len(calls) == 20:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "    return move\n"
        "Bars.start_share = begin\n"
        "from eigenscan.cli.entry import main; main()"
    )
    (tmp_path / "drive.mcap").symlink_to(drive / "drive.mcap")
    command = [sys.executable, "-c", code, *typed.split()]
    done = subprocess.run(command, check=False, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 130, done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["drive.mcap"]


@pytest.mark.parametrize(
    ("typed", "word", "offered"),
    [("eigenscan simu", 1, "simulate"), ("eigenscan simulate --kid", 2, "--kidnap")],
)
def test_the_shell_completes(tmp_path: Path, typed: str, word: int, offered: str) -> None:
    shell = {"_EIGENSCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(word)}
    command = [str(Path(sys.executable).with_name("eigenscan"))]
    published = subprocess.run(command, env=os.environ | shell, capture_output=True, text=True, check=False)
    assert published.stdout.split() == [offered]


def test_every_heading_of_the_help_is_of_commands_that_there_are(tmp_path: Path) -> None:
    from eigenscan.cli.main import HEADINGS

    assert {name for names in HEADINGS.values() for name in names} <= set(COMMANDS)
    listing = _run("--help", cwd=tmp_path).stdout
    assert [heading for heading in HEADINGS if f"\n{heading}:\n" in listing] == list(HEADINGS)
    assert all(listing.count(f"\n  {name} ") == 1 for name in COMMANDS)


def test_a_simulation_shows_what_it_wrote(tmp_path: Path) -> None:
    options = [
        "--robots",
        2,
        "--robot",
        "r",
        "-o",
        "f.mcap",
        "--truth",
        "f.tum",
        "--kidnap",
        2,
        "--json",
        "-",
    ]
    figures = _figures(_run("simulate", "--seconds", 4, *options, cwd=tmp_path))
    assert figures["recording"] == "f.mcap"
    assert list(figures["robots"]) == ["r1", "r2"]
    for driven in figures["robots"].values():
        assert driven["scans"] == 40
        assert len((tmp_path / driven["truth"]).read_text().splitlines()) == driven["scans"]
        # at most a brisk walk; the kidnap, some metres at once, is no way that it drove
        assert 0 < driven["metres"] < 4 * 1.5


def test_a_picture_shows_what_it_drew(drive: Path) -> None:
    figures = _figures(_run("view", "drive.mcap", "--rrd", "d.rrd", "--no-open", "--json", "-", cwd=drive))
    assert figures["picture"] == "d.rrd"
    assert figures["messages"] > 20
    assert figures["recording_s"] == pytest.approx(2.0, abs=0.2)
    assert figures["whole"]


def test_a_playback_shows_what_it_published(drive: Path) -> None:
    options = ["--site", f"p{os.getpid()}", "--wait", 0, "--speed", 100, "--json", "-"]
    figures = _figures(_run("replay", "drive.mcap", *options, cwd=drive))
    assert figures["played"]["scan_raw"] == 20
    assert set(figures["played"]) == {"scan_raw", "odometry"}
    assert not figures["heard_by_somebody"]


def test_playing_to_nobody_is_a_failure(drive: Path) -> None:
    result = _run("replay", "drive.mcap", "--site", f"n{os.getpid()}", "--wait", 0.1, cwd=drive)
    assert result.returncode == 1
    assert "nobody subscribes to" in result.stderr
    assert "--wait 0" in result.stderr


def test_a_comparison_shows_both_verdicts(drive: Path) -> None:
    reported = ["--service", "scan-ingest", "--json", "-"]
    assert (
        _figures(_run("replay", "drive.mcap", *reported, "--out", "said.mcap", cwd=drive))["result"] is None
    )
    same = _figures(_run("replay", "said.mcap", *reported, "--compare", cwd=drive))
    assert same["result"] == "same"
    assert same["channels"]["scan"]["same"] == 20
    assert same["first_difference"] is None
    other = _run("replay", "said.mcap", *reported, "--compare", "--set", "range_max=3", cwd=drive)
    assert other.returncode == 1
    figures = json.loads(other.stdout)
    assert figures["result"] == "different"
    assert figures["channels"]["scan"]["different"] > 0
    assert figures["first_difference"]["fields"]
    assert (drive / figures["picture"]).exists()


def test_services_show_events_line_by_line(drive: Path) -> None:
    site = f"e{os.getpid()}"
    built = _run("build", "map.yaml", "-o", "events", "--step", 2, cwd=drive)
    assert built.returncode == 0
    command = [
        *EIGENSCAN,
        "run",
        "--map",
        "events",
        "--site",
        site,
        "--no-viewer",
        "--json",
        "-",
        "-o",
        "ran",
    ]
    with subprocess.Popen(
        command, cwd=drive, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as services:
        assert services.stdout is not None
        try:
            ready = json.loads(services.stdout.readline())
            assert (ready["event"], ready["site"], ready["folder"]) == ("ready", site, "ran")
            played = _run("replay", "drive.mcap", "--site", site, cwd=drive)
            assert played.returncode == 0, played.stderr
            first = json.loads(services.stdout.readline())
            assert first["event"] == "state"
            assert first["state"] in ("lost", "ambiguous", "localized")
            assert 0 <= first["confidence"] <= 1
        finally:
            services.send_signal(signal.SIGINT)
        rest = [json.loads(line) for line in services.stdout]
        assert services.wait(30) == 0
    assert rest[-1]["event"] == "ended"


def test_a_program_of_ones_own_stands_in_for_a_service(drive: Path) -> None:
    """Here the other program is our projector too, started by hand: what matters is that run starts none."""
    site = f"w{os.getpid()}"
    assert _run("build", "map.yaml", "-o", "alone", "--step", 2, cwd=drive).returncode == 0
    flags = ["--site", site, "--no-viewer", "--json", "-", "-o", "without", "--without", "projector"]
    own = subprocess.Popen(
        [Path(sys.executable).with_name("eigenscan-projector"), "--site", site, "--robot", "robot"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    with subprocess.Popen(
        [*EIGENSCAN, "run", "alone", *flags],
        cwd=drive,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as services:
        assert services.stdout is not None
        try:
            assert json.loads(services.stdout.readline())["event"] == "ready"
            assert _run("play", "drive.mcap", "--site", site, cwd=drive).returncode == 0
            assert json.loads(services.stdout.readline())["event"] == "state"
            logs = {log.stem for log in (drive / "without" / "logs").iterdir()}
            assert "tracker" in logs
            assert "projector" not in logs
        finally:
            services.send_signal(signal.SIGINT)
            own.terminate()
        assert services.wait(30) == 0
    assert own.wait(10) == 0


def test_every_command_that_finds_something_has_json() -> None:
    writes_files_only = {"fleet certify", "fleet configure", "fleet revoke"}
    others = {"fleet", "fleet metrics", *writes_files_only}
    for name in [*COMMANDS, *(f"fleet {name}" for name in fleet.COMMANDS)]:
        command: Any = typer.main.get_command(app)
        for word in name.split():
            command = command.get_command(None, word)
        options = [option for parameter in command.params for option in parameter.opts]
        assert ("--json" in options) != (name in others), name
