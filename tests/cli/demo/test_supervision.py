"""Children are ended in every case: theirs, ours, and when nobody is left to end them."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest
from eigenscan.cli.launch.supervision import STOP_SETTING, ChildDiedError, Supervisor
from eigenscan.runtime.receive_watchdog import EXIT_DEAF

PATIENCE_S = 240.0
Make = Callable[[str, str], str]


@pytest.fixture
def make(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Writes a module with a `main` that children can import."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))

    def write(name: str, body: str) -> str:
        code = "import signal, sys, time, pathlib\n\ndef main():\n" + textwrap.indent(
            textwrap.dedent(body), "    "
        )
        (tmp_path / f"{name}.py").write_text(code)
        return name

    return write


def _eventually(holds: Callable[[], bool], seconds: float = PATIENCE_S) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if holds():
            return True
        time.sleep(0.02)
    return False


def test_a_child_that_dies_is_named_with_its_last_words(tmp_path: Path, make: Make) -> None:
    module = make("dies", "print('one'); print('the disk is full', file=sys.stderr); sys.exit(3)")
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("projector", module, [])
        process = supervisor.children["projector"].process
        assert process.wait(PATIENCE_S) == 3
        with pytest.raises(ChildDiedError, match=r"(?s)projector ended with exit code 3.*the disk is full"):
            supervisor.check()


@pytest.mark.parametrize(("first", "code"), [("Supervisor", 7), ("nobody", 1)])
def test_a_child_of_a_containers_first_process_runs(
    tmp_path: Path, make: Make, first: str, code: int
) -> None:
    """Its parent's number is 1, as that of a child whose parent has died."""
    module, own = make("answers", "sys.exit(7)"), {"Supervisor": "1", "nobody": str(os.getpid())}
    script = (
        "import os, sys; from eigenscan.cli.launch import child; os.getppid = lambda: 1; "
        f"sys.argv[1:] = {[own[first], module]}; child.main()"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, timeout=PATIENCE_S, check=False)
    assert done.returncode == code


def test_a_user_with_very_many_pipes_starts_children_too(
    tmp_path: Path, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Linux lets a user have 64 large pipes: those of the services of ten robots on one machine."""

    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr("eigenscan.cli.launch.output.fcntl.fcntl", refuse)
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("recorder", make("speaks", "print('viewer: http://here', flush=True)"), [])
        supervisor.children["recorder"].process.wait(PATIENCE_S)
        assert _eventually(lambda: supervisor.children["recorder"].output.link == "http://here")


def test_a_full_disk_costs_log_lines_and_not_the_child(
    tmp_path: Path, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the file as its standard error, the child ended, and nobody learned why."""
    module = make("speaks", "print('viewer: http://here', flush=True); sys.exit('mcap: the disk is full')")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs/recorder.log").symlink_to("/dev/full")
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("recorder", module, [])
        child = supervisor.children["recorder"]
        assert child.process.wait(PATIENCE_S) == 1
        with pytest.raises(ChildDiedError, match="mcap: the disk is full"):
            supervisor.check()
        assert child.output.link == "http://here"


def test_a_killed_child_is_reported_as_killed(tmp_path: Path, make: Make) -> None:
    module = make("sleeps", "print('up', flush=True); time.sleep(600)")
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("tracker", module, [])
        supervisor.check()
        process = supervisor.children["tracker"].process
        process.send_signal(signal.SIGKILL)
        process.wait(PATIENCE_S)
        with pytest.raises(ChildDiedError, match="tracker was killed by signal 9"):
            supervisor.check()


def test_flags_reach_the_child(tmp_path: Path, make: Make) -> None:
    module = make("tells", "print(sys.argv[1:], flush=True); time.sleep(600)")
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("mapbuilder", module, ["--map", "a b.yaml"])
        child = supervisor.children["mapbuilder"]
        assert _eventually(lambda: "['--map', 'a b.yaml']" in child.output.last_lines())


def test_a_child_that_will_not_end_is_killed(
    tmp_path: Path, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STOP_SETTING, "0.5")
    module = make(
        "stubborn", "signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); time.sleep(600)"
    )
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("tracker", module, [])
        child = supervisor.children["tracker"]
        assert _eventually(lambda: "up" in child.output.last_lines())
    assert child.process.returncode == -signal.SIGKILL


def test_all_end_also_when_this_process_fails(tmp_path: Path, make: Make) -> None:
    module = make("sleeps", "time.sleep(600)")
    processes = []

    def interrupted() -> None:
        with Supervisor(tmp_path / "logs") as supervisor:
            for name in ("scan-ingest", "tracker"):
                supervisor.start(name, module, [])
                processes.append(supervisor.children[name].process)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert all(process.returncode is not None for process in processes)


def test_the_recorder_receives_the_last_words(tmp_path: Path, make: Make) -> None:
    body = """
        def end(*_):
            time.sleep(0.3)
            with pathlib.Path(sys.argv[1]).open("a") as file:
                file.write(sys.argv[2] + chr(10))
            sys.exit(0)
        signal.signal(signal.SIGTERM, end)
        print("up", flush=True)
        time.sleep(600)
    """
    module, order = make("ends", body), tmp_path / "order"
    with Supervisor(tmp_path / "logs") as supervisor:
        for name in ("recorder", "tracker", "projector"):
            supervisor.start(name, module, [str(order), name])
        assert _eventually(
            lambda: all("up" in child.output.last_lines() for child in supervisor.children.values())
        )
    assert order.read_text().splitlines()[-1] == "recorder"
    assert len(order.read_text().splitlines()) == 3


def test_some_can_be_kept(tmp_path: Path, make: Make) -> None:
    module = make("sleeps", "time.sleep(600)")
    with Supervisor(tmp_path / "logs") as supervisor:
        for name in ("recorder", "tracker"):
            supervisor.start(name, module, [])
        tracker = supervisor.children["tracker"].process
        supervisor.stop(keep=["recorder"])
        assert tracker.returncode is not None
        assert list(supervisor.children) == ["recorder"]
        supervisor.check()


@pytest.mark.skipif(sys.platform != "linux", reason="the parent's death is told on Linux only")
def test_children_do_not_outlive_a_killed_parent(tmp_path: Path, make: Make) -> None:
    make("sleeps", "print('up', flush=True); time.sleep(600)")
    parent_code = textwrap.dedent(
        f"""
        import time
        from pathlib import Path
        from eigenscan.cli.launch.supervision import Supervisor
        supervisor = Supervisor(Path({str(tmp_path / "logs")!r}))
        supervisor.start("tracker", "sleeps", [])
        print(supervisor.children["tracker"].process.pid, flush=True)
        time.sleep(600)
        """
    )
    with subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = psutil.Process(int(parent.stdout.readline()))
        log = tmp_path / "logs/tracker.log"
        assert _eventually(lambda: "up" in log.read_text())
        parent.kill()
    assert _eventually(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)


def test_a_child_that_went_deaf_is_started_again(tmp_path: Path, make: Make) -> None:
    begun = tmp_path / "begun"
    module = make(
        "deafens",
        f"""
        with pathlib.Path({str(begun)!r}).open("a") as file:
            file.write("begun\\n")
        if pathlib.Path({str(begun)!r}).read_text().count("begun") == 1:
            sys.exit({EXIT_DEAF})
        time.sleep(600)
        """,
    )
    with Supervisor(tmp_path / "logs") as supervisor:
        supervisor.start("tracker", module, [])
        first = supervisor.children["tracker"].process
        assert first.wait(PATIENCE_S) == EXIT_DEAF
        supervisor.check()
        second = supervisor.children["tracker"].process
        assert second is not first
        assert _eventually(lambda: begun.read_text().count("begun") == 2)
        supervisor.check()
        assert second.poll() is None
