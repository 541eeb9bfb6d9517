"""The program that is judged may write without end, and start others: neither stays behind."""

import time
from pathlib import Path

import pytest
from eigenscan.runtime.errors import UsageError
from eigenscan.workbench.conformance.candidate import KEPT_BYTES, Candidate

LOUD = "import os, sys; [os.write(1, b'x' * 65536) for _ in range(2000)]; os.write(1, b'\\nlast\\n')"


def test_only_the_end_of_what_it_writes_is_kept() -> None:
    """130 MB within a second, which went to the disk: 80 GB in two minutes."""
    with Candidate(["python3", "-c", LOUD], {}) as loud:
        while loud.lives:
            time.sleep(0.01)
        assert loud.last_lines[-1] == "last"
        assert len("".join(loud.last_lines)) <= KEPT_BYTES
        assert loud.obituary == "it ended with code 0: last"


def test_a_file_that_is_no_program_is_named_with_the_fix(tmp_path: Path) -> None:
    script = tmp_path / "my_tracker.py"
    script.write_text("print('without its first line, which names the interpreter')")
    script.chmod(0o755)
    with pytest.raises(UsageError, match=r"my_tracker.py: Exec format error: check the command after --"):
        Candidate([str(script)], {})


def test_what_it_started_ends_with_it(tmp_path: Path) -> None:
    note = tmp_path / "child"
    with Candidate(["sh", "-c", f"sleep 1000 & echo $! > {note}; wait"], {}):
        while not (note.exists() and note.read_text().strip()):
            time.sleep(0.01)
    child = Path("/proc") / note.read_text().strip() / "stat"
    for _ in range(500):
        if not child.exists() or child.read_text().split()[2] == "Z":
            return
        time.sleep(0.01)
    raise AssertionError("it still runs")
