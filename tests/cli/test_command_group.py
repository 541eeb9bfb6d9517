"""The command's manners: one line for a user's error, exit codes, a quick start."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.command import eigenscan
from tests.environment import EIGENSCAN


def _expect_one_line(result: subprocess.CompletedProcess[str], command: str, *parts: str) -> None:
    assert result.returncode == 2, result.stderr
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith(f"eigenscan {command}: ")
    for part in parts:
        assert part in lines[0]


@pytest.mark.parametrize("command", ["simulate", "demo", "run"])
def test_a_map_without_a_resolution(tmp_path: Path, command: str) -> None:
    (tmp_path / "map.yaml").write_text("image: map.pgm\norigin: [0, 0, 0]\n")
    result = eigenscan(command, "--map", tmp_path / "map.yaml", "--out", tmp_path / "out")
    _expect_one_line(result, command, "map.yaml", "resolution")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("command", ["simulate", "demo", "run"])
def test_a_map_that_is_not_there(tmp_path: Path, command: str) -> None:
    result = eigenscan(command, "--map", tmp_path / "absent.yaml", "--out", tmp_path / "out")
    _expect_one_line(result, command, "absent.yaml")


def test_a_kidnap_outside_the_drive(tmp_path: Path) -> None:
    result = eigenscan("simulate", "-o", tmp_path / "a.mcap", "--seconds", 10, "--kidnap", 12)
    _expect_one_line(result, "simulate", "--kidnap 12")


def test_nothing_to_do() -> None:
    _expect_one_line(eigenscan("simulate"), "simulate", "--truth")


def test_a_file_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    result = eigenscan("simulate", "-o", tmp_path / "file/drive.mcap", "--seconds", 1)
    _expect_one_line(result, "simulate", str(tmp_path / "file"))


def test_a_zenoh_file_that_is_none(tmp_path: Path) -> None:
    (tmp_path / "zenoh.json5").write_text("{ nonsense")
    result = eigenscan("simulate", "--live", "--seconds", 1, "--zenoh", tmp_path / "zenoh.json5")
    _expect_one_line(result, "simulate", "zenoh.json5")


def test_debug_shows_the_trace(tmp_path: Path) -> None:
    result = eigenscan("--debug", "simulate", "--map", tmp_path / "absent.yaml", "-o", tmp_path / "a.mcap")
    assert "Traceback" in result.stderr
    assert "MapError" in result.stderr


@pytest.mark.parametrize(
    ("command", "usage"),
    [
        ("import", "[OPTIONS] LOG"),
        ("build", "[OPTIONS] MAP..."),
        ("conform", "[OPTIONS] SERVICE -- PROGRAM..."),
        ("models", "[OPTIONS] list|rollback|accept MODEL [VERSION]"),
        ("fleet relocate", "[OPTIONS] ROBOT"),
    ],
)
def test_the_usage_line_has_no_python_in_it(command: str, usage: str) -> None:
    shown = eigenscan(*command.split(), "--help").stdout
    assert shown.splitlines()[0] == f"Usage: eigenscan {command} {usage}"
    assert not re.search(r"<(path|str|list\[)", shown)


def _raise_within_compiled_code(error: BaseException, layers: int) -> None:
    """As numba's calls do: "returned a result with an exception set", of up to two functions."""
    if not layers:
        raise error
    try:
        _raise_within_compiled_code(error, layers - 1)
    except BaseException as inner:
        raise SystemError("returned a result with an exception set") from inner


@pytest.mark.parametrize("layers", [0, 1, 2])
def test_ctrl_c_ends_with_what_was_done_and_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], layers: int
) -> None:
    from eigenscan.cli.main import app
    from eigenscan.workbench.progress import Bars

    def work() -> None:
        with Bars() as bars:
            bars.start_share("log")(0.4)
            advance = bars.start("windows", 25)
            for _step in range(3):
                advance()
            _raise_within_compiled_code(KeyboardInterrupt(), layers)

    monkeypatch.setattr("eigenscan.cli.repair.repair", work)
    monkeypatch.setattr(sys, "argv", ["eigenscan", "repair"])
    with pytest.raises(SystemExit) as ended:
        app()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "eigenscan repair: ended by Ctrl-C: log 40 %, windows 3 of 25\n"


@pytest.mark.parametrize("layers", [1, 2])
@pytest.mark.parametrize(
    ("signalled", "code", "words"),
    [(KeyboardInterrupt(), 130, "eigenscan repair: ended by Ctrl-C\n"), (SystemExit(143), 143, "")],
)
def test_a_signal_within_compiled_code_is_no_fault_of_ours(
    monkeypatch: pytest.MonkeyPatch, signalled: BaseException, code: int, words: str, layers: int
) -> None:
    monkeypatch.setattr("eigenscan.cli.repair.repair", lambda: _raise_within_compiled_code(signalled, layers))
    ended = eigenscan("repair")
    assert (ended.returncode, ended.stderr) == (code, words)


def test_a_command_that_is_none_names_those_that_are() -> None:
    result = eigenscan("fly")
    assert result.returncode == 2
    assert "fly" in result.stderr
    assert "simulate" in result.stderr


def test_an_option_out_of_range() -> None:
    result = eigenscan("simulate", "-o", "a.mcap", "--beams", 1)
    assert result.returncode == 2
    assert "--beams" in result.stderr


@pytest.mark.parametrize(
    ("typed", "place", "part"),
    [
        ("build map.yaml", "build", "'--out'"),
        ("replay a.mcap --compare", "replay", "'--service'"),
        ("play a.mcap --robt r1", "play", "did you mean --robot?"),
        ("models", "models", "rollback"),
        ("models MODEL", "models", "give list, rollback or accept first: eigenscan models list MODEL"),
        ("fleet status --wat", "fleet status", "--wat"),
    ],
)
def test_what_is_typed_wrongly_takes_one_line(typed: str, place: str, part: str) -> None:
    result = eigenscan(*typed.split())
    _expect_one_line(result, place, part, f"see eigenscan {place} --help")


@pytest.mark.parametrize(
    ("typed", "place", "part"),
    [
        ("evaluate map.yaml drive.csv", "evaluate", "map.yaml: is a map, no log: give a log in its place"),
        ("evaluate drive.csv map.yaml", "evaluate", "drive.csv: the first line must name the columns"),
        ("evaluate one.csv map.yaml", "evaluate", "one.csv: the log has 1 scan; 3 are needed"),
        ("build map.yaml -o out", "build", "map.yaml: image map.pgm is missing"),
        ("view map.yaml", "view", "map.yaml: is no readable recording: no MCAP; eigenscan import"),
        ("view drive.csv --layout operater", "view", "'operater' is not one of 'operator'"),
        ("fleet status --zenoh none.json5", "fleet status", "none.json5: no such Zenoh configuration"),
        ("fleet fetch r1 --from 15", "fleet fetch", "--from 15: give how long ago (15m, 2h)"),
        ("simulate --seconds soon -o a.mcap", "simulate", "'--seconds': must be a valid number: see"),
    ],
)
def test_a_usual_mistake_names_the_file_or_option_and_the_fix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str, place: str, part: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("map.yaml").write_text("image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\n")
    Path("drive.csv").write_text("time,x\n1,2\n")
    Path("one.csv").write_text("time_s,angle_min_deg,angle_increment_deg,range_m_0,range_m_1\n5,0,1,1,2\n")
    _expect_one_line(eigenscan(*typed.split()), place, part)


def test_an_unknown_option_before_the_command_takes_one_line() -> None:
    result = eigenscan("--hlep")
    assert result.returncode == 2
    assert result.stderr == "eigenscan: no such option: --hlep, did you mean --help?: see eigenscan --help\n"


def test_a_missing_argument_is_named() -> None:
    _expect_one_line(eigenscan("evaluate", "--map", "map.yaml"), "evaluate", "LOG is missing", "--help")
    _expect_one_line(eigenscan("evaluate", "a", "b", "--log", "c"), "evaluate", "LOG is given twice")
    _expect_one_line(eigenscan("run"), "run", "MAP", "missing")


def test_replay_without_a_service_still_plays() -> None:
    _expect_one_line(eigenscan("replay", "absent.mcap", "--speed", 2), "play", "absent.mcap")


def test_short_help_has_twelve_options_at_most_and_help_all_has_the_rest() -> None:
    from eigenscan.cli import fleet
    from eigenscan.cli.main import COMMANDS

    for name in [*COMMANDS, *(f"fleet {each}" for each in fleet.COMMANDS)]:
        if name not in ("fleet", "models"):
            shown = eigenscan(*name.split(), "--help").stdout
            options = re.findall(r"^  (?:-\w, )?--(?!help )[a-z0-9-]+", shown, re.MULTILINE)
            assert 1 <= len(options) <= 12, (name, options)
    assert "--noise" not in eigenscan("simulate", "--help").stdout
    assert "--noise" in eigenscan("simulate", "--help-all").stdout


@pytest.mark.parametrize("command", ["evaluate --log drive.bag", "run"])
@pytest.mark.parametrize(
    ("typed", "part"),
    [
        ("--method papre", "choose one of default, paper"),
        ("--set tracker.trust", "give SERVICE.SETTING=VALUE"),
        ("--set trakcer.trust=1", "did you mean tracker?"),
        ("--set tracker.trst=1", "did you mean trust?"),
        ("--set tracker.trust=9", "--set tracker.trust = '9'"),
        ("--settings none.toml", "none.toml: cannot be read"),
    ],
)
def test_a_setting_that_is_none_takes_one_line(command: str, typed: str, part: str) -> None:
    result = eigenscan(*command.split(), "--map", "map.yaml", *typed.split())
    _expect_one_line(result, command.split(maxsplit=1)[0], part)


@pytest.mark.parametrize("command", ["doctor", "fleet status", "fleet relocate r1 --search"])
def test_a_site_that_no_key_can_have_ends_the_command(command: str) -> None:
    place = command.partition(" r1")[0]
    _expect_one_line(eigenscan(*command.split(), "--site", "a/b"), place, "site", "a/b")


@pytest.mark.parametrize("command", ["simulate", "evaluate", "run"])
def test_a_file_that_is_no_map(tmp_path: Path, command: str) -> None:
    (tmp_path / "drive.bag").write_bytes(b"#ROSBAG V2.0\n\xbb\xcd" * 9)
    scans = "".join(f"{n},0,1,2,2\n" for n in range(3))
    columns = "time_s,angle_min_deg,angle_increment_deg,range_m_0,range_m_1"
    (tmp_path / "drive.csv").write_text(f"{columns}\n{scans}")
    log = ["--log", tmp_path / "drive.csv"] if command == "evaluate" else ["--out", tmp_path / "out"]
    result = eigenscan(command, "--map", tmp_path / "drive.bag", *log)
    _expect_one_line(result, command, "drive.bag", "map_server yaml")


def test_every_command_has_help_with_an_example() -> None:
    from eigenscan.cli import fleet
    from eigenscan.cli.main import COMMANDS

    for group, commands in (((), COMMANDS), (("fleet",), fleet.COMMANDS)):
        listing = eigenscan(*group, "--help")
        assert listing.returncode == 0
        for name, (_, line) in commands.items():
            assert f"  {name}" in listing.stdout
            assert line[:30] in listing.stdout
            own = eigenscan(*group, name, "--help")
            assert own.returncode == 0, own.stderr
            if name == "fleet":
                continue  # a group: its commands have the examples
            typed = " ".join(["eigenscan", *group, name, ""])
            assert typed in own.stdout.partition("xample")[2], f"{name} has no example"


def test_an_error_in_a_group_names_the_whole_command() -> None:
    result = eigenscan("fleet", "status", "--zenoh", "absent.json5", "--once")
    assert result.returncode == 2
    assert result.stderr.startswith("eigenscan fleet status: absent.json5: ")
    assert "Traceback" in eigenscan("fleet", "status", "--zenoh", "absent.json5", "--debug").stderr


@pytest.mark.parametrize(
    "typed", ["--version", "fleet --help", "fly", "simulate", "simulate --map absent.yaml -o a.mcap --debug"]
)
def test_a_process_of_its_own_ends_as_it_does_here(typed: str) -> None:
    """So that the tests need not start one for each command."""
    words = typed.split()
    process = subprocess.run(
        [EIGENSCAN, *words], capture_output=True, text=True, check=False, env=os.environ | {"COLUMNS": "80"}
    )
    here = eigenscan(*words, COLUMNS="80")
    assert process.returncode == here.returncode
    assert process.stdout == here.stdout
    last = [published.stderr.strip().rpartition("\n")[2] for published in (process, here)]
    assert last[0] == last[1]


def test_help_starts_without_the_heavy_imports() -> None:
    heavy = {"numpy", "numba", "zenoh", "rerun"}
    code = f"import sys, eigenscan.cli.main; print(sorted({heavy} & set(sys.modules)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_the_version_is_printed() -> None:
    result = eigenscan("--version")
    assert result.returncode == 0
    assert result.stdout.count(".") == 2


def test_live_simulation_keeps_the_pace(tmp_path: Path) -> None:
    from eigenscan.workbench.simulation.live import publish
    from eigenscan.workbench.simulation.stage import Scenario, Stage
    from eigenscan.workbench.simulation.world import office

    stage = Stage(office().render(), Scenario(seconds=1.0, people=0))
    published: list[str] = []
    begun = time.monotonic()
    publish(stage.messages(), lambda envelope: published.append(envelope.channel.name), speed=2.0)
    # never ahead of the clock; how late is the machine's affair
    assert time.monotonic() - begun >= 0.49
    assert published.count("scan_raw") == 10


def test_a_command_mistyped_is_answered_with_the_one_that_was_meant() -> None:
    result = eigenscan("buidl")
    assert result.returncode == 2
    assert "did you mean build?" in result.stderr


@pytest.mark.parametrize("command", [("play",), ("view", "--no-open", "--rrd", "x.rrd")])
def test_a_bag_in_a_recordings_place_is_reported_with_how_to_become_one(
    tmp_path: Path, command: tuple[str, ...]
) -> None:
    bag = tmp_path / "drive.bag"
    bag.write_bytes(b"#ROSBAG V2.0\n" + bytes(4096))
    words = f"drive.bag: is a ROS 1 bag, not a recording: eigenscan import {bag} makes one of it"
    _expect_one_line(eigenscan(command[0], bag, *command[1:]), command[0], words)
