"""A checkout that is brought up to date does not run code that was compiled of older sources."""

import shutil
import subprocess
from pathlib import Path

ROOT = Path(__file__).parents[2]
COMPILED = ("geometry", "services/projector", "services/scan-ingest", "services/tracker")


def test_compiled_code_goes_when_what_it_calls_changes(tmp_path: Path) -> None:
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools/setup", tmp_path / "tools/setup")
    (tmp_path / "requirements.lock").touch()
    (tmp_path / "pyproject.toml").touch()
    caches = dict[str, Path]()
    for package in COMPILED:
        source = tmp_path / package / "src/eigenscan"
        source.mkdir(parents=True)
        (tmp_path / package / "pyproject.toml").touch()
        (source / "compiled.py").write_text("@njit\ndef f(): ...\n")
        (source / "plain.py").write_text("A = 1\n")
        caches[package] = source / "__pycache__/compiled.f-1.py311.nbi"
        caches[package].parent.mkdir()
    inputs = "requirements.lock tools/setup pyproject.toml ./*/pyproject.toml services/*/pyproject.toml"
    (tmp_path / ".venv").mkdir()
    subprocess.run(f"cat {inputs} | sha256sum > .venv/.setup", shell=True, cwd=tmp_path, check=True)

    def left() -> set[str]:
        """The packages whose compiled code is still there after a set-up."""
        for cache in caches.values():
            cache.touch()
        subprocess.run(["tools/setup"], cwd=tmp_path, check=True)
        return {package for package, cache in caches.items() if cache.exists()}

    def change(file: str) -> None:
        with (tmp_path / file).open("a") as out:
            out.write("# changed\n")

    assert left() == set()  # of what sources these are nobody knows
    assert left() == set(COMPILED)
    change("services/tracker/src/eigenscan/plain.py")
    assert left() == set(COMPILED)
    change("services/tracker/src/eigenscan/compiled.py")
    assert left() == set(COMPILED) - {"services/tracker"}
    change("geometry/src/eigenscan/compiled.py")
    assert left() == set()
