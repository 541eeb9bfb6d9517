"""What robots and services state reaches an operator's terminal as words alone."""

import sys
from pathlib import Path

import pytest
import typer
from eigenscan.cli import doctor
from eigenscan.fleet.diagnosis import Finding


def test_a_robots_words_give_the_terminal_no_orders(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hostile = "r17 \x1b[2J\x1b]0;owned\x07 all is well"
    monkeypatch.setattr(doctor, "_of_this_machine", list)
    monkeypatch.setattr(doctor, "_of_the_site", lambda *_: [Finding(hostile, hostile, hostile)])
    with pytest.raises(typer.Exit):
        doctor.doctor(site="s")
    shown = capsys.readouterr().out
    assert shown.count("owned") == 3
    assert shown.replace("\n", "").isprintable()


def test_without_what_reads_certificates_it_looks_at_the_rest(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without eigenscan[fleet] it ended at once."""
    monkeypatch.setitem(sys.modules, "cryptography", None)
    for name in ("eigenscan.fleet.expiry", "eigenscan.fleet.authority"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(doctor, "_of_this_machine", list)
    monkeypatch.setattr(doctor, "_of_the_site", lambda *_: [])
    doctor.doctor(site="s", zenoh=tmp_path / "none.json5")
    assert "all is well" in capsys.readouterr().out
