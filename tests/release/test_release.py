"""What would be published: built, installed in a clean environment, and used."""

import json
import re
import shutil
import subprocess
import tarfile
import tomllib
import zipfile
from email import message_from_string
from email.message import Message
from pathlib import Path

import pytest
import yaml

from tests.environment import ROOT

pytestmark = pytest.mark.timeout(3600)  # a build takes over ten minutes beside others


def _release(root: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [str(root / "tools/release"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    """The project's versions, to be changed."""
    parts = (
        "LICENSE",
        "pyproject.toml",
        "*/LICENSE",
        "*/pyproject.toml",
        "services/*/LICENSE",
        "services/*/pyproject.toml",
        "deploy/ros2/*/package.xml",
    )
    for path in [
        path for part in (*parts, "CHANGELOG.md", "CITATION.cff", "tools/release") for path in ROOT.glob(part)
    ]:
        file = path.relative_to(ROOT)
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, tmp_path / file)
    (tmp_path / ".venv").symlink_to(ROOT / ".venv")
    return tmp_path


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a release consists of; each test that needs it takes this one."""
    out = tmp_path_factory.mktemp("dist")
    result = _release(ROOT, "build", "--out", out)
    assert result.returncode == 0, result.stderr
    return out


@pytest.mark.slow
def test_everything_is_built_installed_and_used(dist: Path) -> None:
    with tarfile.open(next(dist.glob("eigenscan_localize-0*.tar.gz"))) as sdist:
        names = sdist.getnames()
    assert any(name.endswith("eigenscan/localize/py.typed") for name in names)
    assert not any("__pycache__" in name for name in names)
    wheels = list(dist.glob("*.whl"))
    assert len(wheels) == len(list(ROOT.glob("*/pyproject.toml"))) + len(
        list(ROOT.glob("services/*/pyproject.toml"))
    )
    for wheel in wheels:
        about, text = _licence(wheel)
        # the workbench brings a real robot's log
        also = " AND CC-BY-3.0" if "workbench" in wheel.name else ""
        assert about["License-Expression"] == f"Apache-2.0{also}", wheel
        assert about["License-File"] == "LICENSE", wheel
        assert text == (ROOT / "LICENSE").read_text(), wheel


@pytest.mark.slow
def test_the_library_stands_alone(dist: Path) -> None:
    """Its page's first example needs nothing of processes and pictures; services report what they lack."""
    result = _release(ROOT, "library", "--out", dist)
    assert result.returncode == 0, result.stderr
    packages, size, *examples = result.stdout.splitlines()
    names = {re.split("[= @]", package)[0] for package in packages.partition("packages: ")[2].split(", ")}
    assert {"eigenscan-localize", "eigenscan-projector", "numba"} <= names
    assert not names & {"eclipse-zenoh", "rerun-sdk", "pyarrow", "matplotlib", "eigenscan-runtime"}
    megabytes = float(size.split()[1])
    assert 100 < megabytes < 500
    assert sum("first example" in line for line in examples) == 2
    assert examples[2:] == [
        f"eigenscan.runtime is not installed: pip install 'eigenscan-{service}[node]'"
        for service in ("scan-ingest", "projector", "tracker", "mapbuilder")
    ]


def _licence(wheel: Path) -> tuple[Message, str]:
    """What a wheel states of itself, and the licence's text in it."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = next(name for name in names if name.endswith(".dist-info/METADATA"))
        text = next(name for name in names if name.endswith(".dist-info/licenses/LICENSE"))
        return message_from_string(archive.read(about).decode()), archive.read(text).decode()


def test_a_distribution_without_the_licence_is_named(workspace: Path) -> None:
    (workspace / "geometry/LICENSE").write_text("another")
    result = _release(workspace, "check")
    assert result.returncode == 1
    assert "geometry/LICENSE" in result.stderr


def test_one_command_sets_the_version_everywhere(workspace: Path) -> None:
    assert _release(workspace, "set", "1.2.3").returncode == 0
    result = _release(workspace, "check")
    assert result.returncode == 1
    assert "CHANGELOG.md" in result.stderr
    (workspace / "CHANGELOG.md").write_text("# Changes\n\n## 1.2.3\n")
    assert _release(workspace, "check").returncode == 0
    cli = tomllib.loads((workspace / "cli/pyproject.toml").read_text())["project"]
    assert cli["version"] == "1.2.3"
    assert yaml.safe_load((workspace / "CITATION.cff").read_text())["version"] == "1.2.3"
    assert "<version>1.2.3</version>" in next(workspace.glob("deploy/ros2/*/package.xml")).read_text()
    siblings = [need for need in cli["dependencies"] if need.startswith("eigenscan-")]
    assert len(siblings) > 5
    assert all(need.endswith("==1.2.3") for need in siblings)


@pytest.mark.parametrize(
    ("old", "new"), [('version = "', 'version = "9'), ("eigenscan-geometry==", "eigenscan-geometry>=")]
)
def test_a_part_that_differs_is_named_with_the_fix(workspace: Path, old: str, new: str) -> None:
    file = workspace / "eigenspace/pyproject.toml"
    file.write_text(file.read_text().replace(old, new, 1))
    result = _release(workspace, "check")
    assert result.returncode == 1
    assert len(result.stderr.strip().splitlines()) == 1
    assert "eigenspace/pyproject.toml" in result.stderr
    assert "tools/release set" in result.stderr


def test_a_citation_of_another_version_is_named(workspace: Path) -> None:
    file = workspace / "CITATION.cff"
    file.write_text(file.read_text().replace("\nversion: ", "\nversion: 9"))
    result = _release(workspace, "check")
    assert result.returncode == 1
    assert "CITATION.cff" in result.stderr


def test_a_development_container_has_the_oldest_python_and_sets_itself_up() -> None:
    made = json.loads((ROOT / ".devcontainer/devcontainer.json").read_text())
    oldest = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
    assert made["image"].startswith(f"python:{oldest.removeprefix('>=')}-")
    command, target = made["postCreateCommand"].split()
    assert command == "make"
    assert f"\n{target}:" in (ROOT / "Makefile").read_text()


def test_a_version_that_is_none_changes_nothing(workspace: Path) -> None:
    assert "such as" in _release(workspace, "set", "next").stderr
    assert _release(workspace, "check").returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["lean", "numeric", "recorder"])
def test_all_that_an_image_installs_has_wheels_for_arm64(layer: str, tmp_path: Path) -> None:
    """Asks the registry, and takes no wheel: Debian 12 has glibc 2.36, Ubuntu 20.04 on has more than 2.28."""
    requirements = ROOT / "deploy/requirements" / f"{layer}.lock"
    asked = [
        ROOT / ".venv/bin/uv", "pip", "install", "--dry-run", "--no-deps", "--require-hashes",
        "--python-version", "3.11", "--python-platform", "aarch64-manylinux_2_28",
        "--only-binary", ":all:", "--target", tmp_path, "-r", requirements,
    ]  # fmt: skip
    done = subprocess.run([str(each) for each in asked], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (count,) = re.findall(r"Would install (\d+) packages", done.stderr)
    assert int(count) > 10
