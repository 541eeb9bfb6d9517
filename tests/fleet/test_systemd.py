"""The units for machines without Docker, as systemd itself reads them."""

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from eigenscan.fleet.configuration import settings

from tests.environment import PROGRAMS, ROOT
from tests.fleet.conftest import run

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


SERVICES = sorted(path.name.removeprefix("eigenscan-") for path in PROGRAMS.glob("eigenscan-*"))
TOGETHER = sorted({*members("robot"), *members("site")})
"""Those that one machine may have."""


def directives(service: str) -> dict[str, list[str]]:
    """What the unit of a service states, with its drop-in."""
    found: dict[str, list[str]] = {}
    for path in (UNITS / "eigenscan@.service", *(UNITS / f"eigenscan@{service}.service.d").glob("*.conf")):
        for line in path.read_text().replace("%i", service).splitlines():
            if re.match(r"\w+=", line):
                name, value = line.split("=", 1)
                found.setdefault(name, []).extend(value.split())
                if not value:  # it empties the list
                    found[name].clear()
    return found


def folders(service: str) -> set[Path]:
    """Those that it may write."""
    unit = directives(service)
    assert "ReadWritePaths" not in unit
    assert unit["ProtectSystem"] == ["strict"]
    kinds = {"CacheDirectory": "/var/cache", "StateDirectory": "/var/lib"}
    for kind in kinds:
        assert unit[f"{kind}Mode"] == ["0700"]
    return {Path(base) / name for kind, base in kinds.items() for name in unit.get(kind, [])}


def test_only_those_that_have_to_speak_to_other_machines() -> None:
    """The router; and the bridge to fleet managers, whose MQTT broker is on a machine of theirs."""
    free = {name for name in SERVICES if "any" not in directives(name)["IPAddressDeny"]}
    assert free == {"router", "vda5050-bridge"}


def test_no_service_writes_what_another_one_runs_or_reads() -> None:
    """Compiled code is loaded as it is, and models and recordings are believed."""
    owned = [(folder, service) for service in TOGETHER for folder in folders(service)]
    for folder, service in owned:
        above = {other for path, other in owned if path == folder or path in folder.parents}
        assert above == {service}, folder
    for service in SERVICES:
        (cache,) = [word for word in directives(service)["Environment"] if word.startswith("NUMBA_")]
        assert Path(cache.split("=")[1]) in folders(service)


@pytest.mark.parametrize("written", [settings("hospital"), settings("hospital", "r17")])
def test_every_folder_that_the_settings_name_is_the_services_own(written: str) -> None:
    for service, values in tomllib.loads(written).items():
        if service not in TOGETHER:
            continue
        words = dict(word.split("=", 1) for word in directives(service)["Environment"])
        for name, value in values.items():
            path = Path(words.get(f"EIGENSCAN_{service}_{name}".upper(), str(value)))
            if path.is_relative_to("/var"):
                assert folders(service) & {path, *path.parents}, f"{service}.{name} = {path}"


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """The root of a machine with the users, and in /etc/eigenscan a site's and a robot's files at once."""
    if os.geteuid():
        pytest.skip("who owns a file is root's to say")
    fleet, root = tmp_path / "fleet", tmp_path / "root"
    done = run("certify", "--site", "hospital", "--address", "10.0.0.5", "--robot", "r17", "-o", fleet)
    assert done.exit_code == 0, done.output
    for part in ("site", "robots/r17", "operator"):
        shutil.copytree(fleet / part, root / "etc/eigenscan", dirs_exist_ok=True)
    for command in (["systemd-sysusers"], ["systemd-tmpfiles", "--create"]):
        asked: list[str | Path] = [
            *command,
            f"--root={root}",
            UNITS / f"eigenscan.{command[0].removeprefix('systemd-')}",
        ]
        ran = subprocess.run(asked, capture_output=True, text=True, check=False)
        assert ran.returncode == 0, ran.stderr
    return root


def users(root: Path) -> dict[str, tuple[int, int]]:
    lines = [line.split(":") for line in (root / "etc/passwd").read_text().splitlines()]
    return {name: (int(own), int(group)) for name, _, own, group, *_ in lines}


def test_each_service_has_a_user_of_its_own(machine: Path) -> None:
    found = users(machine)
    for service in SERVICES:
        (user,) = directives(service)["User"]
        assert user in found, service
        assert directives(service)["Group"] == ["eigenscan"]
    assert len({own for own, _ in found.values()}) == len(found) == len(SERVICES)
    assert 0 not in {own for own, _ in found.values()}


@pytest.mark.parametrize(
    ("service", "keys"),
    [
        ("router", {"router.key", "robot.key"}),
        ("mapbuilder", {"mapbuilder.key"}),
        ("recorder", {"recorder.key"}),
        ("tracker", set()),
    ],
)
def test_a_service_reads_its_own_key_only(machine: Path, service: str, keys: set[str]) -> None:
    folder = machine / "etc/eigenscan"
    own = users(machine)[directives(service)["User"][0]]
    assert {path.name for path in folder.glob("*.key") if _may_read(path, *own)} == keys
    assert all(_may_read(path, *own) for path in folder.glob("*.json5"))
    assert not any(path.stat().st_mode & 0o022 for path in (folder, *folder.iterdir()))


def _may_read(path: Path, own: int, group: int) -> bool:
    found = path.stat()
    shift = 6 if found.st_uid == own else 3 if found.st_gid == group else 0
    return bool(found.st_mode >> shift & 4)
