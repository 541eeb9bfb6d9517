"""The checker of words finds what it is for, and nothing in good text."""

import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from typing import Any

import pytest

from tests.environment import ROOT

_spec = spec_from_file_location("prose", ROOT / "tools/prose.py")
assert _spec
assert _spec.loader
prose: Any = module_from_spec(_spec)
_spec.loader.exec_module(prose)

BANNED = {"keepsakes?": "latched cache", "hears?|heard": "receives"}


def _texts(page: str) -> list[Any]:
    return list(prose.of_page("page.md", page))


@pytest.mark.parametrize(
    "page", ["A Keepsake stays.", "- it hears\n", "| a | b |\n|---|---|\n| x | was heard |\n"]
)
def test_a_banned_word_is_found(page: str) -> None:
    assert [fault for text in _texts(page) for fault in prose.foreign_words(text, BANNED)]


@pytest.mark.parametrize(
    "page", ["`keepsake` is code.", "```\nkeepsake\n```\n", "<!-- heard -->", "The heart."]
)
def test_code_and_other_words_are_left_alone(page: str) -> None:
    assert not [fault for text in _texts(page) for fault in prose.foreign_words(text, BANNED)]


def test_sentences_are_counted_one_by_one() -> None:
    short, long = "Word " * 29 + "end.", "Word " * 30 + "end."
    assert not [fault for text in _texts(f"{short} {short}") for fault in prose.long_sentences(text)]
    assert len([fault for text in _texts(f"{short} {long}") for fault in prose.long_sentences(text)]) == 1


def test_words_are_those_with_a_letter_or_a_digit() -> None:
    assert prose.words("| a | 5 |\n|---|---|\n<!-- note --> ok - *b*") == 4


def test_names_come_apart() -> None:
    assert prose._apart("LatchedCache") == "Latched Cache"
    assert prose._apart("model_shelf") == "model shelf"


def test_all_pages_help_texts_and_settings_are_clean() -> None:
    command = [sys.executable, str(ROOT / "tools/prose.py"), "--check"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
