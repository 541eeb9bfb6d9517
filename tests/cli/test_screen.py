"""The live line keeps its columns, whatever a stranger publishes."""

import pytest
from eigenscan.cli.launch.screen import StatusLine
from eigenscan.runtime.printable import MOST
from rich.console import Console


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("localized  confidence 1.00", "localized  confidence 1.00"),
        ("a\n b\x1b[2J  c", "a b?[2J  c"),
        ("x  " * MOST, ("x  " * MOST)[:MOST] + "…"),
    ],
)
def test_a_line_is_printable_and_of_bounded_length(text: str, shown: str) -> None:
    line = StatusLine()
    line.console = Console(width=80, highlight=False)
    with line.console.capture() as printed:
        line.keep(text)
    assert printed.get() == f"{shown}\n"
