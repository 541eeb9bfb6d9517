"""The events of `eigenscan run --json`."""

import io
import json
from pathlib import Path
from typing import Any

import pytest
from eigenscan.cli.figures import Events
from eigenscan.cli.launch import attend
from eigenscan.cli.launch.supervision import ChildDiedError

Nothing: Any = None


def test_the_last_event_is_that_all_has_ended_and_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def die(*_: object, **__: object) -> None:
        raise ChildDiedError("tracker was killed by signal 9")

    written = io.StringIO()
    monkeypatch.setattr(attend, "_attend", die)
    with pytest.raises(ChildDiedError):
        attend.attend(Nothing, tmp_path, Events(written))
    monkeypatch.setattr(attend, "_attend", lambda *_, **__: None)
    attend.attend(Nothing, tmp_path, Events(written))
    events = [json.loads(line) for line in written.getvalue().splitlines()]
    assert [(each["event"], each["reason"]) for each in events] == [
        ("ended", "tracker was killed by signal 9"),
        ("ended", "asked to end"),
    ]
