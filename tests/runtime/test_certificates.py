"""Why another machine refuses a certificate: Zenoh tries for ever and gives no reason."""

from pathlib import Path

import pytest
from eigenscan.fleet.authority import Authority
from eigenscan.runtime.certificates import fault_in, fault_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Certificates of a site: a robot's, its router's, one that has expired; and another site's robot's."""
    folder = tmp_path_factory.mktemp("certificates")
    ours, theirs = Authority.create("hospital"), Authority.create("hospital")
    ours.issue(folder, "robot", "robot.r17", days=1)
    ours.issue(folder, "router", "site.router", days=1, serves=["localhost"])
    ours.issue(folder, "expired", "robot.r17", days=0)
    theirs.issue(folder / "theirs", "robot", "robot.r17", days=1)
    (folder / "empty.crt").touch()
    return folder


def named(
    folder: Path, certificate: str, key: str = "", ca: str = "ca.crt", side: str = "connect"
) -> dict[str, str]:
    key = key or certificate.replace(".crt", ".key")
    return {
        "root_ca_certificate": str(folder / ca),
        f"{side}_certificate": str(folder / certificate),
        f"{side}_private_key": str(folder / key),
    }


def test_a_sound_certificate_has_no_fault(folder: Path) -> None:
    assert fault_of(named(folder, "robot.crt")) == ""
    assert fault_of(named(folder, "router.crt", side="listen")) == ""
    assert fault_of({}) == ""
    assert fault_in(None) == ""
    assert fault_in(folder / "none.json5") == ""


@pytest.mark.parametrize(
    ("certificate", "key", "ca", "side", "words"),
    [
        ("expired.crt", "", "ca.crt", "connect", "expired.crt has expired"),
        ("theirs/robot.crt", "", "ca.crt", "connect", "is not signed by the authority in"),
        ("robot.crt", "", "theirs/ca.crt", "connect", "is not signed by the authority in"),
        ("robot.crt", "theirs/robot.key", "ca.crt", "connect", "theirs/robot.key is not the key of"),
        ("empty.crt", "robot.key", "ca.crt", "connect", "empty.crt or"),
        ("robot.crt", "", "empty.crt", "connect", "empty.crt is no certificate"),
        ("robot.crt", "", "ca.crt", "listen", "may not be used for this"),
        ("router.crt", "", "ca.crt", "connect", "may not be used for this"),
    ],
)
def test_a_certificate_that_is_refused_is_named(
    folder: Path, certificate: str, key: str, ca: str, side: str, words: str
) -> None:
    assert words in fault_of(named(folder, certificate, key, ca, side))
