"""The base image is the one whose digest is given, whatever its tag stands for meanwhile."""

import re
import shutil
import subprocess
import uuid
from pathlib import Path

from tests.docker.conftest import MARKS, docker
from tests.environment import ROOT

pytestmark = MARKS


def built(folder: Path, base: str) -> subprocess.CompletedProcess[str]:
    """The Dockerfile's first stage, in `folder`."""
    return subprocess.run(
        ["docker", "build", "-q", "--target", "tools", "--build-arg", f"BASE={base}", folder],
        capture_output=True, text=True, timeout=900, check=False,
    )  # fmt: skip


def digest_of(printed: str) -> str:
    """The image's, among what docker build prints."""
    found = re.search(r"sha256:[0-9a-f]{64}", printed)
    assert found, printed
    return found[0]


def test_a_digest_decides(base: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "Dockerfile", tmp_path)
    shutil.copytree(ROOT / "deploy/requirements", tmp_path / "deploy/requirements")
    mark, own = uuid.uuid4().hex, tmp_path / "own"
    own.mkdir()
    (own / "Dockerfile").write_text(f"FROM {base}\nLABEL mark={mark}\n")
    given = digest_of(docker("build", "-q", own))
    made = built(tmp_path, given)
    assert made.returncode == 0, made.stderr
    image = digest_of(made.stdout)
    try:
        assert mark in docker("image", "inspect", "-f", "{{.Config.Labels.mark}}", image)
        another = built(tmp_path, f"{base}@sha256:{'0' * 64}")
        assert another.returncode != 0, "the tag is there, the digest is not"
    finally:
        docker("rmi", "-f", image, given, check=False)
