"""The folder that `eigenscan fleet certify` makes: complete, private, never overwritten; faults in a line."""

import json
import resource
import stat
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID
from eigenscan.fleet import layout
from eigenscan.fleet.configuration import robots_in
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.projector.options import ProjectorOptions
from eigenscan.recorder.options import RecorderOptions
from eigenscan.runtime.router import RouterSettings
from eigenscan.runtime.settings import load
from eigenscan.tracker.options import TrackerOptions

from tests.environment import ROOT
from tests.fleet.conftest import run

FIRST = ("certify", "--site", "hospital", "--address", "10.0.0.5", "--address", "router.hospital.example")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "fleet"
    done = run(*FIRST, "--robot", "r17", "-o", folder)
    assert done.exit_code == 0, done.stderr
    return folder


def certificate(path: Path) -> x509.Certificate:
    return x509.load_pem_x509_certificate(path.read_bytes())


def content(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_site_learns_where_its_map_belongs(folder: Path) -> None:
    """The mapbuilder of /etc/eigenscan needs it there; the page and the command name it before the copy."""
    settings = (folder / "site/eigenscan.toml").read_text()
    (named,) = [line for line in settings.splitlines() if line.startswith("map =")]
    place = named.partition(f"{layout.INSTALLED}/")[2].strip('"')
    page = (ROOT / "docs/fleet.md").read_text()
    (row,) = [line for line in page.splitlines() if line.startswith("| `fleet/site`")]
    assert place in row
    printed = run("certify", "--robot", "r18", "-o", folder).stdout
    assert f"add your map as {place}" in printed
    (folder / "site" / place).parent.mkdir()
    (folder / "site" / place).touch()
    assert "add your map" not in run("certify", "--robot", "r19", "-o", folder).stdout


def test_every_private_key_is_its_owners_only_and_no_configuration_holds_one(folder: Path) -> None:
    keys = sorted(folder.rglob("*.key"))
    assert len(keys) == 6  # authority, router, robot, mapbuilder, recorder, operator
    assert len({key.read_bytes() for key in keys}) == len(keys)
    for key in keys:
        assert stat.S_IMODE(key.stat().st_mode) == 0o600, key
    for path in folder.rglob("*"):
        if path.is_file() and path.suffix != ".key":
            assert "PRIVATE" not in path.read_text(), path


def test_nothing_that_signs_is_for_a_machine(folder: Path) -> None:
    signing = (folder / "authority/ca.key").read_bytes()
    machines = [folder / "site", folder / "operator", folder / "robots/r17"]
    assert not any(signing in content(machine).values() for machine in machines)


def test_certificates_are_for_what_they_are_for_and_not_without_end(folder: Path) -> None:
    authority = certificate(folder / "authority/ca.crt")
    now = datetime.now(UTC)
    for path in [
        *(folder / "site").glob("[!c]*.crt"),
        folder / "operator/operator.crt",
        folder / "robots/r17/robot.crt",
    ]:
        own = certificate(path)
        own.verify_directly_issued_by(authority)
        assert isinstance(own.public_key(), ec.EllipticCurvePublicKey)
        uses = own.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        served = ExtendedKeyUsageOID.SERVER_AUTH
        assert list(uses) == [served if path.stem == "router" else ExtendedKeyUsageOID.CLIENT_AUTH]
        assert own.not_valid_before_utc < now < own.not_valid_after_utc < now + timedelta(days=731)
        assert own.extensions.get_extension_for_class(x509.BasicConstraints).value.ca is False
    names = certificate(folder / "site/router.crt").extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert "router.hospital.example" in names.value.get_values_for_type(x509.DNSName)
    assert "10.0.0.5" in [str(one) for one in names.value.get_values_for_type(x509.IPAddress)]


def test_a_name_may_have_any_letters(tmp_path: Path) -> None:
    done = run("certify", "--site", "s😀", "--address", "h", "--robot", "r😀", "-o", tmp_path / "fleet")
    assert done.exit_code == 0, done.stderr
    assert layout.read(tmp_path / "fleet").site == "s😀"


@pytest.mark.parametrize(
    ("name", "held"), [("r17", "robots/r17/robot.crt"), ("recorder", "site/recorder.crt")]
)
def test_whose_certificate_is_damaged_is_shut_out_all_the_same(folder: Path, name: str, held: str) -> None:
    was = x509.load_pem_x509_certificate((folder / held).read_bytes()).subject.rfc4514_string()
    (folder / held).write_text("damaged")
    done = run("revoke", name, "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert not (folder / held).exists()
    assert was.removeprefix("CN=") not in (folder / "site/router.json5").read_text()
    assert (folder / "revoked" / f"{'site' if name == 'recorder' else 'robot'}.{name}.damaged.crt").exists()


def test_a_robot_more_changes_the_routers_rules_and_the_operators_list(folder: Path) -> None:
    before = content(folder)
    assert run("certify", "--robot", "r18", "-o", folder).exit_code == 0
    after = content(folder)
    changed = {path for path, was in before.items() if after[path] != was}
    assert changed == {folder / "site/router.json5", folder / "operator/operator.json5"}
    assert robots_in(folder / "operator/operator.json5") == ("r17", "r18")
    assert {path.parent for path in set(after) - set(before)} == {folder / "robots/r18"}


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("certify", "--robot", "r17"), ("r17", "fleet revoke r17")),
        (("certify", "--robot", "r18", "--robot", "r18"), ("r18", "twice")),
        (("certify", "--site", "other"), ("--site", "fleet.toml")),
        (("certify", "--robot", "a/b"), ("a/b", "chunk")),
        (("certify", "--robot", "recorder"), ("recorder", "service of the site")),
        (("certify", "--robot", "site"), ("site", "service of the site")),
        (("certify", "--robot", "r18", "--robot", "r" * 50), ("r" * 50, "too long", "shorten")),
        (("revoke", "r99"), ("r99", "r17")),
    ],
)
def test_what_it_refuses_in_one_line_and_leaves_as_it_was(
    folder: Path, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    before = content(folder)
    done = run(*arguments, "-o", folder)
    assert done.exit_code == 2, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stderr.startswith(f"eigenscan fleet {arguments[0]}: ")
    for part in parts:
        assert part in done.stderr
    assert content(folder) == before


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (("certify",), "--address"),
        (("certify", "--site", "a b", "--address", "h"), "site = 'a b'"),
        (
            ("certify", "--site", "s", "--address", "h:7447"),
            "or an IP address, without a port\n",
        ),
        (("certify", "--site", "s", "--address", "fe80::1%eth0"), "without one"),
        (("certify", "--site", "s" * 60, "--address", "h"), "too long"),
        (("certify", "--site", "s", "--address", "h", "--robot", "r1", "--robot", "r" * 50), "too long"),
        (("configure",), "fleet certify"),
        (("revoke", "r17"), "fleet certify"),
    ],
)
def test_no_fleet_and_nothing_left(tmp_path: Path, arguments: tuple[str, ...], part: str) -> None:
    done = run(*arguments, "-o", tmp_path / "fleet")
    assert done.exit_code == 2, done.stderr
    assert part in done.stderr
    assert not (tmp_path / "fleet").exists()


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[air]\nscans = 1.0", ("air.scans", "scan_raw")),
        ("[air]\nscan = true", ("air.scan = True", "valid number")),
        ("[air]\nscan = -1", ("air.scan", "greater than or equal")),
        ("[air]\npose = inf", ("air.pose = inf", "less than or equal to 1000")),
        ("[air]\npose = 1e9", ("air.pose", "less than or equal to 1000")),
        ('[groups]\nr17 = "r17"', ("groups.r17: is a robot's name as well",)),
        ('[groups]\nlab = "a-*"\nlib = "a-1"', ("groups.lab and groups.lib: a-* and a-1 fit the same",)),
        ("[air]\nmodel = 1.0", ("air.model", "robots")),
        ("[robots.r99]\nscan = 1.0", ("robots.r99", "r17")),
        ("speed = 1", ("speed",)),
        ("[air", ("TOML",)),
    ],
)
def test_a_fault_in_fleet_toml_is_named(folder: Path, text: str, parts: tuple[str, ...]) -> None:
    path = folder / "fleet.toml"
    before = content(folder)
    path.write_text(f'site = "hospital"\naddresses = ["10.0.0.5"]\n{text}\n')
    done = run("configure", "-o", folder)
    assert done.exit_code == 2, done.stderr
    assert "fleet.toml" in done.stderr
    for part in parts:
        assert part in done.stderr
    path.write_bytes(before[path])
    assert content(folder) == before


COMMANDS = ("configure",), ("certify", "--robot", "r18")


def test_an_address_that_the_routers_certificate_lacks_is_named_with_its_fix(folder: Path) -> None:
    """The routers' configuration had it, and every robot refused the site's router."""
    settings, router = folder / "fleet.toml", folder / "site/router.crt"
    settings.write_text(settings.read_text().replace("10.0.0.5", "10.0.0.6"))
    before = content(folder)
    for command in COMMANDS:
        done = run(*command, "-o", folder)
        assert done.exit_code == 2, done.stderr
        words = f"addresses: robots refuse 10.0.0.6, for which {router} is not: delete it and router.key, "
        assert f"{words}then run: eigenscan fleet certify -o {folder}" in done.stderr
    assert content(folder) == before
    router.unlink()
    router.with_suffix(".key").unlink()
    assert run("certify", "-o", folder).exit_code == 0
    assert "tls/10.0.0.6:" in (folder / "robots/r17/router.json5").read_text()
    assert run("configure", "-o", folder).exit_code == 0


def test_settings_of_a_former_site_are_named(folder: Path) -> None:
    """The routers denied all keys of services that kept the former name."""
    settings = folder / "fleet.toml"
    settings.write_text(settings.read_text().replace("hospital", "clinic", 1))
    before = content(folder)
    for command in COMMANDS:
        done = run(*command, "-o", folder)
        assert done.exit_code == 2, done.stderr
        assert f"robots/r17/eigenscan.toml: site = 'hospital', and {settings} has 'clinic'" in done.stderr
    assert content(folder) == before
    for path in folder.rglob("eigenscan.toml"):
        path.write_text(path.read_text().replace("hospital", "clinic"))
    assert run("configure", "-o", folder).exit_code == 0


def test_settings_that_are_no_toml_are_named(folder: Path) -> None:
    (folder / "site/eigenscan.toml").write_text("[half")
    done = run("configure", "-o", folder)
    assert done.exit_code == 2
    assert f"{folder / 'site/eigenscan.toml'}: is not TOML" in done.stderr


def test_a_group_without_a_certificate_is_named_and_no_robot_sends_it_scans(folder: Path) -> None:
    before = content(folder)
    settings = folder / "fleet.toml"
    settings.write_text(settings.read_text().replace("[groups]", '[groups]\nlab = "r17"'))
    done = run("configure", "-o", folder)
    assert done.exit_code == 2, done.stderr
    words = f"groups.lab: has no certificate: run: eigenscan fleet certify -o {folder}"
    assert words in done.stderr
    assert run("certify", "--robot", "r18", "-o", folder).exit_code == 0
    with_group = (folder / "robots/r17/router.json5").read_bytes()
    assert with_group != before[folder / "robots/r17/router.json5"]
    # to shut a robot out asks for no certificate
    settings.write_text(settings.read_text().replace('lab = "r17"', 'lib = "r17"'))
    assert run("revoke", "r18", "-o", folder).exit_code == 0
    assert content(folder)[folder / "robots/r17/router.json5"] == before[folder / "robots/r17/router.json5"]


def test_a_certificate_that_is_gone_is_made_again(folder: Path) -> None:
    for path in (folder / "site").glob("recorder.*"):
        path.unlink()
    assert run("certify", "-o", folder).exit_code == 0
    certificate(folder / "site/recorder.crt").verify_directly_issued_by(
        certificate(folder / "authority/ca.crt")
    )


def test_addresses_of_ip_version_6(tmp_path: Path) -> None:
    folder = tmp_path / "fleet"
    assert run("certify", "--site", "s", "--address", "fd00::5", "--robot", "r", "-o", folder).exit_code == 0
    connect = json.loads((folder / "robots/r/router.json5").read_text())["connect"]
    assert connect["endpoints"] == ["tls/[fd00::5]:7447"]


def test_what_is_to_be_installed_is_named(tmp_path: Path) -> None:
    code = (
        "import sys; sys.modules['cryptography'] = None\n"
        f"from eigenscan.cli.main import app; app(['fleet', 'configure', '-o', {str(tmp_path)!r}])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().endswith("certificates need cryptography: pip install 'eigenscan[fleet]'")


def test_the_settings_it_writes_are_those_of_the_services_and_stay_their_owners(folder: Path) -> None:
    robot, site = folder / "robots/r17/eigenscan.toml", folder / "site/eigenscan.toml"
    tracker = load(TrackerOptions, "tracker", ["--config", str(robot)])
    assert (tracker.site, tracker.robot, tracker.instance) == ("hospital", "r17", "r17")
    assert tracker.zenoh == Path("/etc/eigenscan/service.json5")
    assert load(ProjectorOptions, "projector", ["--config", str(robot)]).keep
    assert load(RouterSettings, "router", ["--config", str(robot)]).end_on_change
    assert load(RouterSettings, "router", ["--config", str(site)]).zenoh == Path(
        "/etc/eigenscan/router.json5"
    )
    assert load(RecorderOptions, "recorder", ["--config", str(site)]).robot == "*"
    assert load(MapbuilderOptions, "mapbuilder", ["--config", str(site)]).instance == "site"
    robot.write_text(robot.read_text() + "\n# ours\n")
    assert run("configure", "-o", folder).exit_code == 0
    assert robot.read_text().endswith("# ours\n")


def test_a_new_certificate_keeps_the_settings_that_the_robots_owner_edited(folder: Path) -> None:
    own = folder / "robots/r17"
    files = sorted(path.name for path in own.iterdir())
    settings = own / "eigenscan.toml"
    settings.write_text(f"{settings.read_text()}\n# ours\n")
    assert run("revoke", "r17", "-o", folder).exit_code == 0
    assert [path.name for path in own.iterdir()] == ["eigenscan.toml"]
    assert layout.robots(folder) == ()
    assert run("certify", "--robot", "r17", "-o", folder).exit_code == 0
    assert sorted(path.name for path in own.iterdir()) == files
    assert settings.read_text().endswith("# ours\n")


@contextmanager
def _room_for(size: int) -> Iterator[None]:
    """No file may become larger, bytes: as on a disk that becomes full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("size", [0, 300, 515])
def test_a_full_disk_leaves_no_half_of_a_robot(folder: Path, size: int) -> None:
    """An empty certificate counted as one, and an empty key as a key that nothing may replace."""
    with _room_for(size):
        failed = run("certify", "--robot", "r18", "-o", folder)
    assert failed.exit_code == 2, failed.stderr
    assert "robots/r18/" in failed.stderr
    assert "fault of ours" not in failed.stderr
    assert not [*(folder / "robots/r18").glob("robot.*")]
    done = run("certify", "--robot", "r18", "-o", folder)
    assert done.exit_code == 0, done.stderr


def test_a_robot_that_a_full_disk_did_not_let_be_shut_out_is_named(folder: Path) -> None:
    """It looked shut out: the same command again stated that it has no certificate."""
    router = folder / "site/router.json5"
    with _room_for(2000):
        failed = run("revoke", "r17", "-o", folder)
    assert failed.exit_code == 1, failed.stderr
    assert "r17 is NOT shut out yet" in failed.stderr
    assert f"then run: eigenscan fleet configure -o {folder}" in failed.stderr
    assert "r17" in router.read_text()
    assert run("configure", "-o", folder).exit_code == 0
    assert "r17" not in router.read_text()


def test_what_a_fleet_lacks_and_what_it_cannot_have_has_our_words(folder: Path) -> None:
    (folder / "fleet.toml").write_text("site = 5\nx = 1\n")
    failed = run("configure", "-o", folder)
    assert failed.exit_code == 2
    for words in ("site = 5: must be a valid string", "addresses: must be given", "x: unknown"):
        assert words in failed.stderr


def add_to_settings(folder: Path, text: str) -> None:
    path = folder / "fleet.toml"
    path.write_text(f"{path.read_text()}\n{text}\n")


def test_a_revoked_robot_with_a_table_of_its_own_is_shut_out(folder: Path) -> None:
    """Its rights stayed in the router's file, for configure refused a table without a certificate."""
    assert run("certify", "--robot", "r18", "-o", folder).exit_code == 0
    add_to_settings(folder, "[robots.r17]\nscan_raw = 5.0")
    done = run("revoke", "r17", "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "r17" not in (folder / "site/router.json5").read_text()
    for command in ("configure",), ("certify", "--robot", "r19"):
        done = run(*command, "-o", folder)
        assert done.exit_code == 0, done.stderr
        assert "robots.r17: is left out, for its certificate is revoked: delete the table" in done.stderr
    assert run("certify", "--robot", "r17", "-o", folder).exit_code == 0
    assert "left out" not in run("configure", "-o", folder).stderr


def test_a_revoked_name_that_begins_alike_is_another(folder: Path) -> None:
    add_to_settings(folder, "[robots.r1]\nscan_raw = 5.0\n")
    (folder / "revoked").mkdir(exist_ok=True)
    (folder / "revoked" / "robot.r1.x.0123abcd.crt").touch()
    assert not layout.left_out(folder)
    (folder / "revoked" / "robot.r1.0123abcd.crt").touch()
    assert len(layout.left_out(folder)) == 1


def test_a_fault_that_keeps_a_robot_in_is_named_as_such(folder: Path) -> None:
    add_to_settings(folder, "[robots.r99]\nscan = 1.0")
    failed = run("revoke", "r17", "-o", folder)
    assert failed.exit_code == 1, failed.stderr
    for words in ("r17 is NOT shut out yet", "robots.r99", f"eigenscan fleet configure -o {folder}"):
        assert words in failed.stderr


def test_a_revoked_group_stays_revoked_until_its_owner_wants_a_new_certificate(folder: Path) -> None:
    """The next certify, of another robot, made it a new certificate, and its rights were back."""
    settings, router = folder / "fleet.toml", folder / "site/router.json5"
    settings.write_text(settings.read_text().replace("[groups]", '[groups]\nlab = "r1*"'))
    assert run("certify", "-o", folder).exit_code == 0
    served = (folder / "robots/r17/router.json5").read_text()
    assert run("revoke", "lab", "-o", folder).exit_code == 0
    done = run("certify", "--robot", "r18", "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "group.lab" not in router.read_text()
    assert "groups/lab" not in done.stdout
    (old,) = (folder / "revoked").iterdir()
    assert "groups.lab: is left out, for its certificate is revoked: delete the line" in done.stderr
    assert f"delete {old} and run: eigenscan fleet certify -o {folder}" in done.stderr
    assert (folder / "robots/r17/router.json5").read_text() != served  # its scans no longer leave it for lab
    # a robot of its name could not be told from it
    assert run("certify", "--robot", "lab", "-o", folder).exit_code == 2
    refused = run("revoke", "lab", "-o", folder)
    assert "choose one of r17, r18, mapbuilder" in refused.stderr
    old.unlink()
    done = run("certify", "-o", folder)
    assert done.exit_code == 0, done.stderr
    assert "group.lab" in router.read_text()
    assert "left out" not in done.stderr


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("site/mapbuilder.crt", ("mapbuilder.key: is there already", "mapbuilder.crt or", "move it away")),
        ("fleet.toml", ("ca.key: is there already", "put back what is gone, ca.crt or fleet.toml")),
        ("authority/ca.key", ("ca.key: is not there", "put it back from a copy", "in a new folder")),
        ("authority/ca.crt", ("ca.crt: is not there", "put it back from a copy")),
    ],
)
def test_half_of_a_pair_of_files_is_named_with_its_fix(
    folder: Path, gone: str, words: tuple[str, ...]
) -> None:
    (folder / gone).unlink()
    before = content(folder)
    failed = run(*(FIRST if gone == "fleet.toml" else ("certify",)), "-o", folder)
    assert failed.exit_code == 2, failed.stderr
    for each in words:
        assert each in failed.stderr
    assert content(folder) == before


@pytest.mark.parametrize(
    ("damaged", "words"),
    [
        ("authority/ca.key", "ca.key: is no key that can be read: put it back from a copy; else make"),
        ("authority/ca.crt", "ca.crt: is no certificate: put it back from a copy"),
    ],
)
def test_a_damaged_file_of_the_authority_is_named_with_its_fix(
    folder: Path, damaged: str, words: str
) -> None:
    """An empty key, as a full disk leaves one, was called a fault of ours."""
    (folder / damaged).write_bytes(b"")
    failed = run("certify", "--robot", "r40", "-o", folder)
    assert failed.exit_code == 2, failed.stderr
    assert words in failed.stderr
