"""A router that nobody reaches: its end is a line, where Ctrl-C had no effect and nothing was said."""

import json
import shlex
from pathlib import Path

import pytest
from eigenscan.fleet import view

from tests.command import eigenscan
from tests.network import free_port

PATIENT = {"timeout_ms": -1, "exit_on_failure": False}


@pytest.fixture(params=[PATIENT, {}], ids=["waits without end", "does not wait"])
def config(tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    """A service's, and that of the contract's example."""
    connect = {"endpoints": [f"tcp/127.0.0.1:{free_port()}"], **request.param}
    alone = {"multicast": {"enabled": False}}
    path = tmp_path / "client.json5"
    path.write_text(json.dumps({"mode": "client", "connect": connect, "scouting": alone}))
    return path


@pytest.mark.parametrize(
    "typed",
    ["run map.yaml --no-viewer -o out", "play drive.mcap", "simulate --live --seconds 1"],
)
def test_a_person_does_not_wait_for_a_router_without_end(
    tmp_path: Path, config: Path, typed: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = eigenscan("simulate", "-o", "drive.mcap", "--save-map", "map.yaml", "--seconds", 1, cwd=tmp_path)
    assert made.returncode == 0, made.stderr
    monkeypatch.setattr(view, "OPEN_S", 0.2)
    result = eigenscan(*shlex.split(typed), "--zenoh", config, cwd=tmp_path)
    assert result.returncode == 1, result.stderr
    assert "nobody answers" in result.stderr
    assert str(config) in result.stderr


def test_the_doctor_finds_that_nobody_answers(
    tmp_path: Path, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ended with exit code 2, and no figures, where the configuration does not wait."""
    monkeypatch.setattr(view, "OPEN_S", 0.2)
    done = eigenscan("doctor", "--zenoh", config, "--json", tmp_path / "found.json")
    assert done.returncode == 1, done.stderr
    found = json.loads((tmp_path / "found.json").read_text())
    (finding,) = (each for each in found if each["where"] == "router")
    assert finding["what"].startswith("nobody answers")
    assert f"correct connect.endpoints in {config}" in finding["mend"]


@pytest.mark.parametrize(
    "typed",
    [
        "doctor",
        "fleet status --once",
        "fleet metrics --port 0",
        "fleet fetch r1 --from 15m",
        "fleet relocate r1 --search",
    ],
)
def test_a_site_that_no_key_can_have_is_refused_before_anything_is_opened(typed: str) -> None:
    """fetch waited for an answer; the others named a key's field."""
    refused = eigenscan(*shlex.split(typed), "--site", "a b")
    assert refused.returncode == 2
    assert "--site 'a b': a name has no blanks" in refused.stderr
