"""Standard output that ends early, is full or is closed: words that fit, and no trace."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.environment import EIGENSCAN

COMMANDS = ["--help", "--version", "evaluate --help", "fleet certify --help", "simtest --seeds 0..0"]


def _run(typed: str, rest: str, folder: Path) -> subprocess.CompletedProcess[str]:
    line = f"{shlex.quote(str(EIGENSCAN))} {typed} {rest}"
    return subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_reader_that_has_enough_is_no_fault(tmp_path: Path, typed: str) -> None:
    result = _run(typed, "| true; exit ${PIPESTATUS[0]}", tmp_path)
    assert (result.returncode, result.stderr) == (141, "")


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_full_standard_output_is_named(tmp_path: Path, typed: str) -> None:
    result = _run(typed, "> /dev/full", tmp_path)
    assert result.returncode == 2
    assert "standard output: No space left on device: make room, or name another place" in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_full_standard_output_is_not_taken_for_what_is_written(tmp_path: Path) -> None:
    made = _run("simulate --seconds 1 -o drive.mcap", "", tmp_path)
    assert made.returncode == 0, made.stderr
    result = _run("import drive.mcap -o a.mcap", "> /dev/full", tmp_path)
    assert result.returncode == 2
    assert result.stderr.startswith("eigenscan import: standard output: No space left")


def test_an_output_in_ascii_loses_no_finished_work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A degree sign ended `import` and `evaluate` after all their work."""
    _run("simulate --seconds 1 -o drive.mcap", "", tmp_path)
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    result = _run("import drive.mcap -o drove.mcap", "", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    result = _run("import drive.mcap -o é.mcap --json -", "", tmp_path)
    assert (result.returncode, result.stderr) == (0, "")
    assert json.loads(result.stdout)["recording"].endswith("é.mcap")


def test_a_terminal_of_no_width_is_of_an_unknown_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _run("simulate --seconds 1 -o drive.mcap", "", tmp_path)
    monkeypatch.setenv("COLUMNS", "0")
    assert "odometry" in _run("import drive.mcap -o drove.mcap", "", tmp_path).stdout


def test_a_closed_standard_input_is_no_keyboard(tmp_path: Path) -> None:
    _run("simulate --seconds 1 -o drive.mcap", "", tmp_path)
    result = _run("play drive.mcap --wait 0 --speed 100", "<&-", tmp_path)
    assert (result.returncode, result.stderr.strip()) == (0, "")


def test_a_working_folder_that_is_gone_is_named(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    result = _run("--version", f"; rmdir {folder}; {shlex.quote(str(EIGENSCAN))} doctor --json -", folder)
    assert result.returncode == 2
    assert f"{folder}: this folder is gone" in result.stderr


@pytest.mark.parametrize("typed", COMMANDS)
def test_closed_outputs_are_no_failure(tmp_path: Path, typed: str) -> None:
    assert _run(typed, ">&- 2>&-", tmp_path).returncode == 0


def test_a_closed_standard_error_is_no_failure(tmp_path: Path) -> None:
    """Import, build, map and others ended with code 1, did nothing, and could not say why."""
    result = _run("simulate --seconds 1 -o drive.mcap", "2>&-", tmp_path)
    assert result.returncode == 0
    assert (tmp_path / "drive.mcap").stat().st_size > 0


@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-", "<&- >&- 2>&-"])
def test_no_file_takes_the_place_of_a_closed_stream(tmp_path: Path, closed: str) -> None:
    """What a library writes to standard error would be in it."""
    code = (
        "import os, sys\n"
        "from pathlib import Path\n"
        "from eigenscan.runtime.closed_streams import lead_nowhere\n"
        "lead_nowhere()\n"
        "with Path('number').open('w') as file:\n"
        "    print('a word', file=sys.stderr, flush=True)\n"
        "    os.write(2, b'a word')\n"
        "    print(file.fileno() > 2, file=file)\n"
    )
    line = f"{shlex.quote(sys.executable)} -c {shlex.quote(code)} {closed}"
    subprocess.run(["bash", "-c", line], cwd=tmp_path, check=True, timeout=60)
    assert (tmp_path / "number").read_text() == "True\n"


def test_a_service_runs_with_a_closed_standard_error(tmp_path: Path) -> None:
    """It ended with code 1, and its error took the place of its output."""
    code = (
        "from eigenscan.runtime.logs import configure\n"
        "from eigenscan.runtime.node import exit_with\n"
        "exit_with('x', lambda: 'auto', lambda style, stop: configure('info', style).info('ready') or 0)\n"
    )
    line = f"{shlex.quote(sys.executable)} -c {shlex.quote(code)} 2>&-"
    done = subprocess.run(["bash", "-c", line], cwd=tmp_path, check=False, capture_output=True, timeout=60)
    assert (done.returncode, done.stdout) == (0, b"")


STILL_OPENING = """
import sys, threading, time
from eigenscan.cli import entry, main

class Slow:
    def __del__(self, sleep=time.sleep):
        sleep(1.5)

def app():
    import zenoh
    config = zenoh.Config()
    config.insert_json5("mode", "'client'")
    config.insert_json5("connect/endpoints", "['tcp/127.0.0.1:1']")
    config.insert_json5("connect/timeout_ms", "700")
    threading.Thread(target=zenoh.open, args=(config,), daemon=True).start()
    time.sleep(0.1)
    print("done")
    sys.exit(int(sys.argv[1]))

keep = Slow()
main.app = app
entry.main()
"""


@pytest.mark.parametrize("code", [0, 1, 130])
def test_a_session_that_still_opens_does_not_abort_the_end(code: int) -> None:
    """Ctrl-C in `eigenscan play` gave 'FATAL: exception not rethrown' and a core file in one of 15."""
    ended = subprocess.run(
        [sys.executable, "-c", STILL_OPENING, str(code)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert (ended.returncode, ended.stdout) == (code, "done\n")
    assert "FATAL" not in ended.stderr
