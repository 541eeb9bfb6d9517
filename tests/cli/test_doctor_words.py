"""What robots and services state reaches an operator's terminal as words alone."""

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
