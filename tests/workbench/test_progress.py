"""Progress of long work where standard error is a file, such as the log of a night's build."""

import pytest
from eigenscan.workbench.progress import Bars


def test_a_log_gets_a_line_now_and_then_and_nothing_of_short_work(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    with Bars(transient=True) as bars:
        moved, advance = bars.start_steps(), bars.start("windows", 25)
        for second in range(8):
            now = float(second)
            moved("regions", second / 100)
            advance()
        assert capsys.readouterr().err == ""
        for second in range(8, 31):
            now = float(second)
            moved("regions", second / 100)
    assert capsys.readouterr().err.splitlines() == ["regions 10 %", "regions 20 %", "regions 30 %"]
