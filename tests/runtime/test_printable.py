import errno
import json
import os

import pytest
from eigenscan.runtime.errors import one_line
from eigenscan.runtime.logs import configure
from eigenscan.runtime.printable import MOST, in_link, printable


@pytest.mark.parametrize(
    "hostile",
    [
        "\x1b[2J\x1b]0;owned\x07all is well",
        "\x9b31mred",
        "line\rover",
        "turned \u202e round",
        "hidden \u200b space",
        "bell\x07",
    ],
)
def test_nothing_that_a_terminal_obeys_is_shown(hostile: str) -> None:
    shown = printable(hostile)
    assert shown.isprintable()
    assert printable(shown) == shown


def test_a_log_on_a_terminal_shows_no_more(capsys: pytest.CaptureFixture[str]) -> None:
    hostile = "site/\x1b[2J\x1b]0;owned\x07"
    configure("info", "console").warning("foreign_key", key=hostile)
    shown = capsys.readouterr().err
    assert "owned" in shown
    assert "[2J" in shown
    # the colours of the level are ours
    assert shown.replace("\x1b[33m", "").replace("\x1b[0m", "").rstrip("\n").isprintable()


def test_words_of_any_language_stay_as_they_are() -> None:
    for text in ("état: prêt, 12 m²", "ロボット r17", json.dumps({"a": 1})):
        assert printable(text) == text


def test_an_error_that_quotes_a_whole_file_is_cut() -> None:
    assert len(one_line(ValueError("y" * 10**7))) == MOST + 1


def test_a_disk_that_cannot_be_written_is_named_with_what_to_do() -> None:
    """A service began its line with [Errno 30]."""
    error = OSError(errno.EROFS, os.strerror(errno.EROFS), "recordings/a.mcap")
    assert one_line(error) == "recordings/a.mcap: Read-only file system: name another place"


@pytest.mark.parametrize(
    ("host", "shown"), [("10.0.0.5", "10.0.0.5"), ("::1", "[::1]"), ("robot.example", "robot.example")]
)
def test_an_address_of_ip_version_6_has_brackets_in_a_link(host: str, shown: str) -> None:
    assert in_link(host) == shown
