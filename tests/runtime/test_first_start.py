"""A first start compiles, logs it, and starts again as the same process; a later start does not."""

import os
import subprocess
import sys
from pathlib import Path

PROGRAM = """
import os, sys
from eigenscan.runtime.first_start import compiling, should_start_again, start_again
with compiling(lambda: print("compiling")) as compiled:
    import kernel
print("made", os.getpid(), len(compiled), *sys.argv[1:])
if should_start_again(compiled):
    start_again()
print("ready", kernel.twice(21.0) + kernel.half(4.0))
"""
KERNEL = """
from numba import njit
@njit("f8(f8)", cache={cache})
def twice(x):
    return x * 2.0
@njit("f8(f8)", cache={cache})
def half(x):
    return x * 0.5
"""


def started(folder: Path) -> list[str]:
    """The lines of a program that compiles `kernel.py` of the folder and keeps it there."""
    program = folder / "program.py"
    program.write_text(PROGRAM)
    kept = os.environ | {"NUMBA_CACHE_DIR": str(folder / "kept")}
    command = [sys.executable, str(program), "--robot", "r 17"]
    result = subprocess.run(command, env=kept, capture_output=True, text=True, check=True)
    return result.stdout.splitlines()


def test_what_was_compiled_is_started_again_as_the_same_process(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL.format(cache=True))
    hint, first, second, ready = started(tmp_path)
    assert hint == "compiling"
    _, process, count, *arguments = first.split(maxsplit=3)
    assert (count, arguments) == ("2", ["--robot r 17"])
    assert second == f"made {process} 0 --robot r 17"
    assert ready == "ready 44.0"
    made, ready = started(tmp_path)
    assert made.split()[2] == "0"
    assert ready == "ready 44.0"


def test_where_nothing_compiled_can_be_kept_it_starts_again_once(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL.format(cache=False))
    lines = started(tmp_path)
    assert [line.split()[0] for line in lines] == ["compiling", "made", "compiling", "made", "ready"]
