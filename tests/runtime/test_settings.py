import os
import subprocess
import sys
from pathlib import Path
from typing import Literal

import pytest
from eigenscan.runtime.settings import ServiceSettings, SettingsError, load
from eigenscan.workbench.settings_page import KINDS, settings_of
from pydantic import Field


class ProbeSettings(ServiceSettings):
    """Settings of all kinds, 100 % made up."""

    spacing: float = Field(0.5, gt=0, description="m, at most 50 % of a room")
    beams: int = 361
    verify: bool = True
    model: Path | None = None
    lidars: list[str] = Field(["front"])
    limits: tuple[float, float] = (0.1, 30.0)
    method: Literal["tree", "cells"] = "tree"


@pytest.fixture(autouse=True)
def clean(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in [name for name in os.environ if name.startswith("EIGENSCAN_")]:
        monkeypatch.delenv(name)
    monkeypatch.chdir(tmp_path)


def _load(*arguments: str) -> ProbeSettings:
    return load(ProbeSettings, "scan-probe", list(arguments))


def _file(text: str) -> str:
    Path("robot.toml").write_text(text)
    return "--config=robot.toml"


def test_without_any_the_defaults_hold() -> None:
    assert _load() == ProbeSettings()
    assert (_load().site, _load().robot, _load().instance) == ("site", "robot", "robot")


def test_flags_win_over_environment_over_file(monkeypatch: pytest.MonkeyPatch) -> None:
    config = _file(
        'site = "f"\nrobot = "f"\n[scan-probe]\nspacing = 1\nbeams = 1\nlog_level = "error"\nrobot = "own"'
    )
    assert _load(config).robot == "own"
    monkeypatch.setenv("EIGENSCAN_SPACING", "2")
    monkeypatch.setenv("EIGENSCAN_BEAMS", "2")
    monkeypatch.setenv("EIGENSCAN_SCAN_PROBE_BEAMS", "3")
    settings = _load(config, "--beams", "4")
    assert (settings.site, settings.log_level) == ("f", "error")
    assert (settings.spacing, settings.beams) == (2.0, 4)
    assert _load(config).beams == 3


def test_the_file_may_be_named_by_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    _file("[scan-probe]\nbeams = 7")
    monkeypatch.setenv("EIGENSCAN_CONFIG", "robot.toml")
    assert _load().beams == 7


def test_an_empty_variable_is_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EIGENSCAN_METRICS_PORT", "")
    monkeypatch.setenv("EIGENSCAN_CONFIG", "")
    assert _load().metrics_port is None


@pytest.mark.parametrize(("text", "value"), [("false", False), ("0", False), ("off", False), ("yes", True)])
def test_truth_values(text: str, value: bool) -> None:
    assert _load("--verify", text).verify is value
    assert _load("--verify").verify is True


def test_values_of_all_kinds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EIGENSCAN_LIMITS", "[1, 2.5]")
    settings = _load("--lidars", '["a", "b"]', "--model", "m/n", "--method", "cells", "--spacing", "1e-1")
    assert settings.lidars == ["a", "b"]
    assert settings.limits == (1.0, 2.5)
    assert settings.model == Path("m/n")
    assert (settings.method, settings.spacing) == ("cells", 0.1)
    from_file = _load(_file('[scan-probe]\nlidars = ["c"]\nmodel = "x.y"\nverify = false'))
    assert (from_file.lidars, from_file.model, from_file.verify) == (["c"], Path("x.y"), False)


def test_an_instance_is_named_after_its_robot() -> None:
    assert _load("--robot", "r17").instance == "r17"
    assert _load("--robot", "*").instance == "0"
    assert _load("--robot", "a-*,b-7").instance == "a-+,b-7"
    assert _load("--robot", "r17", "--instance", "b").instance == "b"


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (["--beams", "many"], ["--beams = 'many'", "integer"]),
        (["--spacing", "-1"], ["--spacing = '-1'", "greater than 0"]),
        (["--metrics-port", "70000"], ["--metrics-port = '70000'", "65535"]),
        (["--log-level", "loud"], ["--log-level = 'loud'", "debug|info|warning|error"]),
        (["--lidars", "front"], ["--lidars = 'front'", "list", '["a", "b"]']),
        (["--lidars", "[1"], ["--lidars = '[1'", '["a", "b"]']),
        (["--method", "guess"], ["--method = 'guess'", "'tree' or 'cells'"]),
        (["--verify", "maybe"], ["--verify = 'maybe'", "boolean"]),
        (["--site", "a/b"], ["--site = 'a/b'", "one chunk"]),
        (["--site", "*"], ["--site = '*'", "one chunk"]),
        (["--robot", "a b"], ["--robot = 'a b'", "no blanks"]),
        (["--robot", "a,"], ["--robot = 'a,'", "'' is no robot"]),
        (["--robot", "a-*,b,a-1"], ["a-* and a-1 fit the same robots", "once"]),
        (["--robot", "a*,*b"], ["a* and *b fit the same robots"]),
        (["--robot", "*,b"], ["* and b fit the same robots"]),
        (["--beams", "x", "--spacing", "y"], ["--beams = 'x'", "--spacing = 'y'"]),
        (["--keep", ""], ["--keep = ''", "give a path, or leave it out"]),
        (["--config", ""], ["--config = ''", "give a path, or leave it out"]),
        (["--config", "none.toml"], ["none.toml: cannot be read", "No such file", "--config"]),
    ],
)
def test_a_bad_flag_is_named_with_what_would_do(arguments: list[str], parts: list[str]) -> None:
    with pytest.raises(SettingsError) as error:
        _load(*arguments)
    for part in parts:
        assert part in str(error.value)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("site = x", ["robot.toml: is not TOML", "line 1"]),
        ("[scan-probe]\nbeams = 'x'", ["robot.toml: [scan-probe] beams = 'x'", "integer"]),
        ("[scan-probe]\nlidars = ['a', 2]", ["robot.toml: [scan-probe] lidars.1 = 2", "string"]),
        ("[scan-probe]\nspacnig = 1", ["robot.toml: [scan-probe] spacnig: unknown", "did you mean spacing?"]),
        ("siet = 's'", ["robot.toml: siet: unknown", "did you mean site?"]),
        ("spacing = 1", ["robot.toml: spacing: unknown", "is it for [scan-probe]?"]),
        ("[scan-prob]\nbeams = 1", ["robot.toml: [scan-prob]: unknown", "[scan-probe]?"]),
        ("scan-probe = 1", ["robot.toml: scan-probe: must be a table"]),
        ("site = 1", ["robot.toml: site = 1", "string"]),
        ("site = true", ["robot.toml: site = True", "string"]),
        ("[scan-probe]\nbeams = true", ["robot.toml: [scan-probe] beams = True: must be a number, not true"]),
        (
            "[scan-probe]\nspacing = true",
            ["robot.toml: [scan-probe] spacing = True: must be a number"],
        ),
        (
            "[scan-probe]\nlimits = [0.1, true]",
            ["robot.toml: [scan-probe] limits = [0.1, True]: must be"],
        ),
        ("[scan-probe]\nv_max = 2.0", ["robot.toml: [scan-probe] v_max: unknown: docs/settings.md has"]),
    ],
)
def test_a_bad_file_is_named_with_place_and_fix(text: str, parts: list[str]) -> None:
    config = _file(text)
    with pytest.raises(SettingsError) as error:
        _load(config)
    for part in parts:
        assert part in str(error.value)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    Path("robot.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(SettingsError, match=r"robot.toml: is not TOML: byte 0 is not UTF-8: save"):
        _load("--config", "robot.toml")
    with pytest.raises(SettingsError, match="cannot be read"):
        _load("--config", str(tmp_path))


def test_a_file_may_begin_with_a_byte_order_mark() -> None:
    Path("robot.toml").write_text('\ufeffsite = "hospital"', encoding="utf-8")
    assert _load("--config", "robot.toml").site == "hospital"


def test_other_services_tables_are_theirs() -> None:
    assert _load(_file("[projector]\nanything = 1\n[tracker]\nbeams = 'x'")) == ProbeSettings()


@pytest.mark.parametrize(
    ("variable", "value", "parts"),
    [
        ("EIGENSCAN_BEAMS", "x", ["environment: EIGENSCAN_BEAMS = 'x'", "integer"]),
        ("EIGENSCAN_SCAN_PROBE_BEAMS", "x", ["environment: EIGENSCAN_SCAN_PROBE_BEAMS = 'x'"]),
        (
            "EIGENSCAN_SCAN_PROBE_BAEMS",
            "1",
            ["EIGENSCAN_SCAN_PROBE_BAEMS: unknown", "EIGENSCAN_SCAN_PROBE_BEAMS?"],
        ),
        (
            "EIGENSCAN_SCAN_PORBE_BEAMS",
            "1",
            ["EIGENSCAN_SCAN_PORBE_BEAMS: unknown", "did you mean EIGENSCAN_SCAN_PROBE_BEAMS?"],
        ),
        ("EIGENSCAN_LOG_LEVLE", "debug", ["EIGENSCAN_LOG_LEVLE: unknown, did you mean EIGENSCAN_LOG_LEVEL?"]),
        ("EIGENSCAN_SIET", "x", ["did you mean EIGENSCAN_SITE?"]),
        ("EIGENSCAN_CONFG", "x", ["did you mean EIGENSCAN_CONFIG?"]),
    ],
)
def test_a_bad_variable_is_named(
    monkeypatch: pytest.MonkeyPatch, variable: str, value: str, parts: list[str]
) -> None:
    monkeypatch.setenv(variable, value)
    with pytest.raises(SettingsError) as error:
        _load()
    for part in parts:
        assert part in str(error.value)


@pytest.mark.parametrize(
    "variable",
    ["OLD_EIGENSCAN_PROBE_SITE", "EIGENSCAN_SCAN_SETS_BEAMS", "EIGENSCAN_PROBE_BEAMS", "EIGENSCAN_MAPS"],
)
def test_what_other_programs_are_given_is_theirs(monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    monkeypatch.setenv(variable, "1")
    assert _load() == ProbeSettings()


@pytest.mark.parametrize("service", KINDS)
def test_each_services_settings_are_another_services_own(
    monkeypatch: pytest.MonkeyPatch, service: str
) -> None:
    """However much they resemble one of all services: STEP is not SITE."""
    for name in settings_of(service).model_fields:
        own = f"{service.replace('-', '_')}_{name}"
        for variable in (own, *(() if name in ServiceSettings.model_fields else (name,))):
            if variable not in ProbeSettings.model_fields:
                monkeypatch.setenv(f"EIGENSCAN_{variable.upper()}", "1")
    assert _load() == ProbeSettings()


def test_a_bad_robot_is_one_fault_only() -> None:
    """The instance, which would be named after it, is not spoken of."""
    with pytest.raises(SettingsError) as error:
        _load("--robot", "a/b")
    assert str(error.value).startswith("--robot = 'a/b': 'a/b' is no robot: ")
    assert "instance" not in str(error.value)


@pytest.mark.parametrize("flag", ["--spacnig", "--spac"])
def test_an_unknown_or_shortened_flag_is_refused_with_the_nearest(flag: str) -> None:
    with pytest.raises(SettingsError, match=f"{flag}: no such option, did you mean --spacing"):
        _load(flag, "1")


def test_help_shows_every_field_and_default(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        _load("--help")
    assert end.value.code == 0
    reported = " ".join(capsys.readouterr().out.split())
    for name in ProbeSettings.model_fields:
        assert f"--{name.replace('_', '-')}" in reported
    assert "m, at most 50 % of a room (default: 0.5)" in reported
    assert "100 % made up" in reported


@pytest.mark.parametrize(
    ("flag", "code", "out", "err"),
    [("--help", 0, "example: ", ""), ("--nonsense", 2, "", "--nonsense: no such option: see eigenscan-")],
)
def test_a_service_answers_its_flags_without_a_trace(flag: str, code: int, out: str, err: str) -> None:
    program = [sys.executable, str(Path(__file__).parent / "tiny_service.py"), flag]
    done = subprocess.run(program, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert out in done.stdout
    assert err in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("seconds", ["1e300", "inf"])
def test_a_stop_that_no_clock_can_count_is_refused(seconds: str) -> None:
    """It ended a service with a trace at SIGTERM."""
    with pytest.raises(SettingsError, match="--stop-s = "):
        load(ServiceSettings, "tracker", ["--stop-s", seconds])


def test_a_service_shows_no_more_than_a_terminal_may_see(tmp_path: Path) -> None:
    odd = tmp_path / "\x1b[31m.json5"
    program = Path(sys.executable).parent / "eigenscan-scan-ingest"
    ended = subprocess.run([program, "--zenoh", odd], capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert "?[31m.json5: no such Zenoh configuration" in ended.stderr
    assert "\x1b" not in ended.stderr
