"""What is needed only to start is given back, and the process goes on as before."""

import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from eigenscan.runtime import memory

MAPPINGS = """\
7f00-7f10 r--p 00000000 fe:00 10 /x/llvmlite/binding/libllvmlite.so
Rss:                  60 kB
Anonymous:             0 kB
7f10-7f20 r-xp 00000010 fe:00 10 /x/llvmlite/binding/libllvmlite.so
Anonymous:             0 kB
VmFlags: rd ex mr mw me
7f20-7f30 r--p 00000020 fe:00 10 /x/llvmlite/binding/libllvmlite.so
Anonymous:            64 kB
7f30-7f40 rw-p 00000030 fe:00 10 /x/llvmlite/binding/libllvmlite.so
Anonymous:             0 kB
7f40-7f50 r-xp 00000000 fe:00 11 /x/a b/libother.so
Anonymous:             0 kB
7f50-7f60 r--p 00000000 00:00 0
Anonymous:             0 kB
"""

PROGRAM = """
from eigenscan.geometry.carving import Carving
from eigenscan.runtime.memory import StartMemory

def resident_mb():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 1e6

def count():
    carving = Carving.around([(0.0, 0.0), (9.0, 9.0)], 1.0)
    carving.add((0.5, 0.5), [(8.5, 8.5)])
    return int(carving.passes.sum())

now = 0.0
kept = StartMemory(lambda: now)
passed, before = count(), resident_mb()
kept.tend()
early, now = resident_mb(), 20.0
kept.tend()
after = resident_mb()

import numba
doubled = numba.njit(lambda x: 2 * x)
print(before - early < 1.0, before - after > 30.0, count() == passed > 0, doubled(21))
"""


def test_only_parts_that_nobody_wrote_to_are_given_back() -> None:
    found = [*memory.unchanged_parts("libllvmlite", MAPPINGS.splitlines())]
    assert found == [(0x7F00, 0x7F10), (0x7F10, 0x7F20)]


@pytest.mark.skipif(sys.platform != "linux", reason="where /proc shows what is mapped")
def test_the_linkers_code_is_given_back_and_code_is_still_linked() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "True", "True", "42"]


def test_where_nothing_lists_what_is_mapped_the_service_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(memory, "_MAPPINGS", tmp_path / "smaps")
    monkeypatch.setitem(sys.modules, memory.ITS_MODULE, ModuleType(memory.ITS_MODULE))
    now = 0.0
    kept = memory.StartMemory(lambda: now)
    now = memory.FIRST_S
    kept.tend()
    assert now + memory.EVERY_S == kept._due
