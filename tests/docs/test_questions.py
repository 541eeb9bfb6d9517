"""Twenty strangers' questions are answered by a sentence of the page that they are sent to."""

import re

import pytest

from tests.environment import ROOT

PAGE = ROOT / "docs/questions.md"
ROWS = re.findall(
    r"^\| (.+?) \| (.+?) \| \[[^\]]+\]\(([\w.-]+)", PAGE.read_text(encoding="utf-8"), re.MULTILINE
)


@pytest.mark.parametrize(("question", "answer", "page"), ROWS, ids=lambda value: value[:30])
def test_the_page_answers(question: str, answer: str, page: str) -> None:
    text = (PAGE.parent / page).read_text(encoding="utf-8")
    lines = [number for number, line in enumerate(text.splitlines(), 1) if answer in line]
    assert lines, f"{page} no longer has the answer to: {question}"


def test_there_are_twenty() -> None:
    assert len(ROWS) == 20
