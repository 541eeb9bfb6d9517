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

EIGENSCAN = [sys.executable, "-m", "eigenscan.cli.main"]


def _run(*arguments: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*EIGENSCAN, *map(str, arguments)],
        **{"cwd": cwd, "env": os.environ | environment, "capture_output": True, "text": True},
        timeout=120,
        check=False,
    )


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


def test_a_json_file_that_cannot_be_written_is_told_before_the_work(drive: Path) -> None:
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
        assert process.wait(20) == 130


@pytest.mark.parametrize(
    ("typed", "word", "offered"),
    [("eigenscan sim", 1, "simulate"), ("eigenscan simulate --kid", 2, "--kidnap")],
)
def test_the_shell_completes(tmp_path: Path, typed: str, word: int, offered: str) -> None:
    shell = {"_EIGENSCAN_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(word)}
    command = [str(Path(sys.executable).with_name("eigenscan"))]
    said = subprocess.run(command, env=os.environ | shell, capture_output=True, text=True, check=False)
    assert said.stdout.split() == [offered]


def test_every_heading_of_the_help_is_of_commands_that_there_are(tmp_path: Path) -> None:
    from eigenscan.cli.main import HEADINGS

    assert {name for names in HEADINGS.values() for name in names} <= set(COMMANDS)
    listing = _run("--help", cwd=tmp_path).stdout
    assert [heading for heading in HEADINGS if f"\n{heading}:\n" in listing] == list(HEADINGS)
    assert all(listing.count(f"\n  {name} ") == 1 for name in COMMANDS)
