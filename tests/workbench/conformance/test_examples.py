"""The components of examples/: written against the contract alone, and they keep it."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from tests.environment import PROGRAMS, ROOT

EXAMPLES = ROOT / "examples"
PROJECTOR = EXAMPLES / "exhaustive-projector"
RUST_INGEST = EXAMPLES / "scan-ingest-rust"


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


def conforms(service: str, *command: object) -> subprocess.CompletedProcess[str]:
    words = [PROGRAMS / "eigenscan", "conform", service, "--latency", 60, "--patience", 10, "--", *command]
    return subprocess.run([str(word) for word in words], capture_output=True, text=True, check=False)


def test_the_projector_knows_nothing_of_ours_but_the_messages() -> None:
    own = {path.stem for path in PROJECTOR.glob("*.py")}
    foreign = (
        set().union(*(imported(path) for path in PROJECTOR.glob("*.py"))) - own - sys.stdlib_module_names
    )
    foreign -= {"collections.abc", "numpy", "numpy.typing", "zenoh", "google.protobuf.message"}
    assert foreign
    assert all(name.endswith("_pb2") for name in foreign), foreign


@pytest.mark.slow
def test_the_projector_conforms() -> None:
    done = conforms("projector", sys.executable, PROJECTOR / "exhaustive_projector.py")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
@pytest.mark.rust
@pytest.mark.timeout(1800)
def test_the_scan_ingest_in_rust_conforms() -> None:
    target = EXAMPLES.parent / "out/rust"
    build = ["cargo", "build", "--release", "--target-dir", str(target)]
    subprocess.run(build, cwd=RUST_INGEST, check=True)
    done = conforms("scan-ingest", target / "release/eigenscan-scan-ingest-rust")
    assert done.returncode == 0, done.stdout + done.stderr
