"""What is fetched to build and test is what was chosen: by hash, by commit, by digest."""

import os
import re
import subprocess
from pathlib import Path

import pytest
import yaml

from tests.environment import ROOT

STUB = """#!/bin/sh
echo "$(basename "$0") $*" >> "$LOG"
for word; do case "$last" in -r) cat "$word" >> "$LOG.installed" ;; esac; last=$word; done
"""
COMPOSED = ("docker-compose.yml", "deploy/fleet.yml", "examples/exhaustive-projector/docker-compose.yml")
DOCKERFILES = ("Dockerfile", "examples/exhaustive-projector/Dockerfile")


def test_setup_installs_nothing_without_a_hash(tmp_path: Path) -> None:
    """Pip and uv are stubs that note what they were asked for."""
    (tmp_path / "tools").mkdir()
    setup = tmp_path / "tools/setup"
    setup.write_bytes((ROOT / "tools/setup").read_bytes())
    (tmp_path / "requirements.lock").write_bytes((ROOT / "requirements.lock").read_bytes())
    for path in [*ROOT.glob("*/pyproject.toml"), *ROOT.glob("services/*/pyproject.toml")]:
        member = tmp_path / path.parent.relative_to(ROOT)
        member.mkdir(parents=True)
        (member / path.name).touch()
    (tmp_path / "pyproject.toml").touch()
    programs = tmp_path / ".venv/bin"
    programs.mkdir(parents=True)
    for name in ("python", "pip", "uv"):
        (programs / name).write_text(STUB)
        (programs / name).chmod(0o755)
    log = tmp_path / "log"
    given = os.environ | {"LOG": str(log), "PYTHON": str(programs / "python")}
    ran = subprocess.run(["bash", setup], env=given, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr
    installs = [line for line in log.read_text().splitlines() if re.match(r"(pip|uv pip) install", line)]
    assert [line.split()[0] for line in installs] == ["pip", "uv", "uv"]
    *foreign, own = installs
    assert all("--require-hashes -r " in line for line in foreign)
    assert "--no-deps" in own
    assert all(word.startswith("-") or (ROOT / word).is_dir() for word in own.split()[3:])
    # by pip alone: the pinned uv, and nothing else
    lock = (ROOT / "requirements.lock").read_text()
    installed = (tmp_path / "log.installed").read_text()
    first = installed.removesuffix(lock)
    assert first in lock
    assert re.findall(r"^([\w-]+)==", first, re.MULTILINE) == ["uv"]
    assert first.count("--hash=sha256:") >= 1


def test_the_forge_runs_what_contributing_states_and_can_write_nothing() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/tests.yml").read_text())
    jobs = workflow["jobs"]
    assert workflow["permissions"] == {"contents": "read"}
    assert not any("permissions" in job for job in jobs.values())
    assert {"push", "pull_request", "schedule"} <= set(workflow[True])  # YAML's "on"
    ran = {name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()}
    assert ran["quick"] == ["make test"]
    assert len(ran["all"]) == 1
    assert ran["all"][0].split()[-1] == ".ci/run"
    assert (ROOT / ".ci/run").read_text().splitlines()[-1] == "make test-all"
    stated = (ROOT / "CONTRIBUTING.md").read_text()
    assert re.search(r"^make test +#", stated, re.MULTILINE)
    assert re.search(r"^make test-all +#", stated, re.MULTILINE)
    for job in jobs.values():
        assert not job["runs-on"].endswith("latest")
        assert job["timeout-minutes"] <= 60
        for step in job["steps"]:
            if "uses" in step:
                assert re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", step["uses"]), "a tag can be moved"


@pytest.mark.parametrize("file", DOCKERFILES)
def test_every_stage_begins_with_the_base_that_is_given(file: str) -> None:
    text = (ROOT / file).read_text()
    before = text[: text.index("\nFROM ")]
    assert re.search(r"^ARG BASE=\S+$", before, re.MULTILINE), "an ARG after FROM is empty in FROM"
    stages = re.findall(r"^FROM (\S+)(?: AS (\S+))?$", text, re.MULTILINE)
    names = {name for _, name in stages}
    assert {origin for origin, _ in stages if origin not in names} == {"${BASE}"}
    copied = re.findall(r"--from=(\S+)", text)
    assert set(copied) <= names


@pytest.mark.parametrize("file", COMPOSED)
def test_what_compose_builds_has_the_base_of_the_environment(file: str) -> None:
    services = yaml.safe_load((ROOT / file).read_text())["services"]
    for name, service in services.items():
        assert service["build"]["args"]["BASE"].startswith("${EIGENSCAN_BASE:-"), name
