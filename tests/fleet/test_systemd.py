"""The units for machines without Docker, as systemd itself reads them."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.environment import PROGRAMS, ROOT

UNITS = ROOT / "deploy/systemd"
WORST_EXPOSURE = 20  # of 100, as systemd-analyze security counts: OK

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")


def analyze(folder: Path, *arguments: str) -> str:
    """Output of systemd-analyze for the units in `folder`. Fails where it does."""
    done = subprocess.run(
        ["systemd-analyze", *arguments], env=os.environ | {"SYSTEMD_UNIT_PATH": f"{folder}:"},
        capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The units, with this machine's programs in the place of /opt/eigenscan."""
    folder = tmp_path / "units"
    shutil.copytree(UNITS, folder)
    template = folder / "eigenscan@.service"
    template.write_text(template.read_text().replace("/opt/eigenscan/bin", str(PROGRAMS)))
    return folder


def members(target: str) -> list[str]:
    text = (UNITS / f"eigenscan-{target}.target").read_text()
    return re.findall(r"eigenscan@([\w-]+)\.service", text)


@pytest.mark.parametrize("target", ["robot", "site"])
def test_systemd_finds_no_fault(units: Path, target: str) -> None:
    names = [f"eigenscan@{name}.service" for name in members(target)]
    reported = analyze(units, "verify", f"eigenscan-{target}.target", *names)
    assert "eigenscan" not in reported, reported


def test_targets_name_programs_that_there_are() -> None:
    for name in {*members("robot"), *members("site")}:
        assert (PROGRAMS / f"eigenscan-{name}").exists(), name


@pytest.mark.parametrize("name", ["router", "tracker"])
def test_a_service_has_few_rights(units: Path, name: str) -> None:
    threshold = f"--threshold={WORST_EXPOSURE}"
    analyze(units, "security", "--offline=true", "--no-pager", threshold, f"eigenscan@{name}.service")


def test_no_service_writes_what_another_one_runs() -> None:
    """Compiled code is loaded as it is: each service can write its own cache only."""
    text = (UNITS / "eigenscan@.service").read_text()
    assert "NUMBA_CACHE_DIR=/var/cache/eigenscan/%i" in text
    assert "CacheDirectory=eigenscan/%i\n" in text
    assert "ReadWritePaths" not in text
