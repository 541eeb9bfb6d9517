"""Playing a recording is under its user's hands: pause, seek, names, stamps, and many of one robot."""

import os
import pty
import re
import subprocess
import termios
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from eigenscan.cli.main import app
from eigenscan.runtime.recording import RecordingWriter
from eigenscan.schemas.channels import MODEL_SET, ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import RawScan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from typer.testing import CliRunner

from tests.environment import PROGRAMS
from tests.system.house import PATIENCE_S, House

pytestmark = pytest.mark.slow

S = 1_000_000_000
START = 1_000 * S
LENGTH_S, RATE_HZ = 20, 5
LEFT, RIGHT = "\x1b[D", "\x1b[C"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Odometry of one robot, RATE_HZ; raw scans once a second; a set of models at the start."""
    path = tmp_path_factory.mktemp("playback") / "one.mcap"
    robot = {"site": "home", "robot": "r1"}
    with RecordingWriter(path) as writer:
        writer.write(Envelope(MODEL_SET, {"site": "home"}, ModelSet(version="first")), START)
        for tick in range(LENGTH_S * RATE_HZ):
            at = START + tick * S // RATE_HZ
            writer.write(Envelope(ODOMETRY, robot, Odometry(timestamp=stamp(at))), at)
            if tick % RATE_HZ == 0:
                scan = RawScan(timestamp=stamp(at + 1), ranges=[float(tick)])
                writer.write(Envelope(SCAN_RAW, robot | {"lidar": "front"}, scan), at + 1)
    return path


def odometry(received: Sequence[Envelope]) -> list[int]:
    """Ticks of the recording that were published, in order of arrival."""
    stamps = [nanoseconds(e.open(Odometry).timestamp) for e in received if e.channel is ODOMETRY]
    return [(stamp - START) * RATE_HZ // S for stamp in stamps]


def ahead(received: Sequence[Envelope]) -> int | None:
    """Which message is the first that does not follow on the one before it."""
    ticks = odometry(received)
    return next((k for k in range(1, len(ticks)) if ticks[k] != ticks[k - 1] + 1), None)


@dataclass
class Desk:
    """A replay at a terminal, and what that shows."""

    process: subprocess.Popen[bytes]
    terminal: int
    shown: str = ""

    def press(self, keys: str) -> None:
        os.write(self.terminal, keys.encode())

    def read_until(self, words: str) -> None:
        """Reads what the terminal shows until `words` come."""
        deadline = time.monotonic() + PATIENCE_S
        start = len(self.shown)
        while not re.search(words, self.shown[start:]):
            assert time.monotonic() < deadline, self.shown[-2000:]
            self.shown += os.read(self.terminal, 65536).decode(errors="replace")


@pytest.fixture
def desk(recording: Path, house: House) -> Iterator[Desk]:
    terminal, theirs = pty.openpty()
    command = [PROGRAMS / "eigenscan", "play", recording, "--site", house.site, "--zenoh", house.config]
    process = subprocess.Popen(
        ["setsid", "--ctty", *map(str, command), "--only", "odometry"],
        stdin=theirs, stdout=subprocess.DEVNULL, stderr=theirs, env=os.environ | {"TERM": "xterm-256color"},
    )  # fmt: skip
    yield Desk(process, terminal)
    process.kill()
    process.wait()
    os.close(terminal)
    os.close(theirs)


def test_keys_of_a_terminal_pause_step_and_seek(desk: Desk, house: House) -> None:
    before = termios.tcgetattr(desk.terminal)
    house.ear.wait_for(lambda received: len(odometry(received)) >= 3, "the first odometry")
    desk.press(" ")
    desk.read_until("paused")
    desk.press(f"..{RIGHT}.")
    house.ear.wait_for(lambda received: ahead(received) is not None, "a message after a skip")
    place = ahead(house.ear.received)
    assert place is not None
    ticks = odometry(house.ear.received)
    assert place >= 5
    assert ticks[:place] == list(range(place))
    assert 5 * RATE_HZ <= ticks[place] - ticks[place - 1] <= 5 * RATE_HZ + 1
    desk.press(f"{LEFT}.")
    house.ear.wait_for(lambda received: len(odometry(received)) > place + 1, "a message after a skip back")
    *before_it, back = odometry(house.ear.received)
    assert before_it == ticks  # each step is one message
    assert 4 * RATE_HZ <= ticks[place] - back <= 5 * RATE_HZ
    desk.press(" ")
    house.ear.wait_for(lambda received: len(odometry(received)) > place + 4, "it goes on")
    desk.press("q")
    assert desk.process.wait(PATIENCE_S) == 0
    assert termios.tcgetattr(desk.terminal) == before


def replay(
    recording: Path, house: House, *flags: object, lines: str = ""
) -> subprocess.CompletedProcess[str]:
    command = [PROGRAMS / "eigenscan", "play", recording, "--site", house.site, "--zenoh", house.config]
    return subprocess.run(
        [*map(str, command), *map(str, flags)], input=lines, capture_output=True, text=True, check=False
    )


def test_words_on_standard_input_do_the_same(recording: Path, house: House) -> None:
    lines = "pause\nstep\nstep\nseek 15\nstep\nskip -5\nstep\nend\n"
    done = replay(recording, house, "--commands", "--only", "odometry", lines=lines)
    assert done.returncode == 0, done.stderr
    house.ear.wait_for(lambda received: 10 * RATE_HZ in odometry(received), "the last step")
    *before, fifteen, ten = odometry(house.ear.received)
    assert len(before) >= 2
    assert before == list(range(len(before)))
    assert (fifteen, ten) == (15 * RATE_HZ, 10 * RATE_HZ)


def test_where_the_words_end_it_plays_on(recording: Path, house: House) -> None:
    done = replay(recording, house, "--commands", "--speed", 10, "--only", "odometry", lines="pause\n")
    assert done.returncode == 0, done.stderr
    house.ear.wait_for(lambda received: len(odometry(received)) == LENGTH_S * RATE_HZ, "all of it")


def test_a_word_that_is_no_command_is_named(recording: Path, house: House) -> None:
    done = replay(recording, house, "--commands", lines="seek soon\n")
    assert done.returncode == 2
    assert "'seek soon' is no command; choose one of toggle, pause" in done.stderr


def test_shifted_stamps_are_of_now_and_never_go_back(recording: Path, house: House) -> None:
    before = time.time_ns()
    lines = "pause\nstep\nstep\nseek 3\nstep\nstep\nplay\n"
    done = replay(recording, house, "--commands", "--stamps", "now", "--to", 5, lines=lines)
    assert done.returncode == 0, done.stderr
    wanted = 2 * (RATE_HZ + 1)  # from 3 s on
    house.ear.wait_for(lambda received: len(received) >= wanted, "all of it")
    after = time.time_ns() + 5 * S
    stamps = [e.stamp for e in house.ear.received]
    assert stamps == sorted(set(stamps))
    assert before <= stamps[0]
    assert stamps[-1] <= after
    # within one stretch they are apart as they were
    assert stamps[-1] - stamps[-2] == S // RATE_HZ


def test_one_robot_becomes_many_each_with_stamps_of_its_own(recording: Path, house: House) -> None:
    done = replay(recording, house, "--robots", 3, "--speed", 20, "--all")
    assert done.returncode == 0, done.stderr
    per_robot = LENGTH_S * (RATE_HZ + 1)
    house.ear.wait_for(lambda received: len(received) >= 3 * per_robot + 1, "all of them")
    robots = [e for e in house.ear.received if "robot" in e.address]
    assert {e.address["robot"] for e in robots} == {"r-001", "r-002", "r-003"}
    assert sum(e.channel is MODEL_SET for e in house.ear.received) == 1
    published = {}
    for number in (1, 2, 3):
        own = [e for e in robots if e.address["robot"] == f"r-{number:03d}"]
        assert len(own) == per_robot
        late = (number - 1) * S // 3
        published[number] = [(e.channel.name, e.stamp - late) for e in own]
    assert sorted(published[1]) == sorted(published[2]) == sorted(published[3])


@pytest.fixture(scope="module")
def two(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("playback") / "two.mcap"
    with RecordingWriter(path) as writer:
        for number in range(10):
            for robot in ("a", "b"):
                at = START + number
                message = Odometry(timestamp=stamp(at))
                writer.write(Envelope(ODOMETRY, {"site": "home", "robot": robot}, message), at)
    return path


@pytest.mark.parametrize("flags", [("--robot", "b"), ("--only", "home/robot/b/**")])
def test_one_of_several_robots_is_chosen(two: Path, house: House, flags: tuple[str, ...]) -> None:
    done = replay(two, house, *flags)
    assert done.returncode == 0, done.stderr
    house.ear.wait_for(lambda received: len(received) >= 10, "what b said")
    assert [e.key for e in house.ear.received] == [f"{house.site}/robot/b/odom"] * 10


@pytest.mark.parametrize(
    ("flags", "named"),
    [
        (("--robot", "c"), "--robot c: the recording holds a, b: choose one of them"),
        (("--robots", "4"), "--robots 4: needs one robot, there is a, b: select one with --robot"),
        (("--only", "home//odom"), "--only home//odom: is no key expression"),
        (("--only", "home/robot/z/**"), "holds nothing on home/robot/z/**: it has odometry: choose with"),
        (("--only", "advice"), "holds nothing on advice: it has odometry: choose with --only"),
        (("--service", "tracker", "--compare", "--robots", "2"), "no such option: --robots"),
    ],
)
def test_what_cannot_be_played_is_reported(two: Path, flags: tuple[str, ...], named: str) -> None:
    done = CliRunner().invoke(app, ["replay", str(two), *flags])
    assert done.exit_code == 2
    assert named in done.stderr
    assert len(done.stderr.splitlines()) == 1
