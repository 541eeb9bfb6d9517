"""Certificates end on a day: all links of a site ended, and nobody had been told."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from eigenscan.fleet.authority import Authority
from eigenscan.fleet.expiry import of_certificates


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """An operator's, whose certificate is valid for a hundred days."""
    Authority.create("hospital").issue(tmp_path, "operator", "operator", days=100)
    tls = {
        "root_ca_certificate": str(tmp_path / "ca.crt"),
        "connect_certificate": str(tmp_path / "operator.crt"),
        "connect_private_key": str(tmp_path / "operator.key"),
    }
    path = tmp_path / "zenoh.json5"
    path.write_text(json.dumps({"mode": "client", "transport": {"link": {"tls": tls}}}))
    return path


@pytest.mark.parametrize(("days", "word"), [(0, ""), (60, ""), (75, "expires"), (101, "expired")])
def test_the_doctor_names_a_certificate_that_ends(config: Path, days: int, word: str) -> None:
    found = list(of_certificates(config, datetime.now(UTC) + timedelta(days=days)))
    assert [f"operator.crt {word} on" in one.what for one in found] == ([True] if word else [])


def test_a_certificate_that_is_not_there_is_named(config: Path) -> None:
    (config.parent / "operator.crt").unlink()
    (found,) = of_certificates(config)
    assert "operator.crt cannot be read" in found.what


def test_a_configuration_without_certificates_has_none_to_name(tmp_path: Path) -> None:
    path = tmp_path / "zenoh.json5"
    path.write_text('{ mode: "peer" }')
    assert list(of_certificates(path)) == []
    assert list(of_certificates(tmp_path / "none.json5")) == []
