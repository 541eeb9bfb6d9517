"""A first look at every reader: attacks, seeds and some damaged inputs. tools/fuzz runs more, for hours."""

from __future__ import annotations

from contextlib import suppress

import pytest

from tests.fuzz.harness import judged, made, numbered
from tests.fuzz.reader import Place
from tests.fuzz.readers import READERS

BUSY_CPU_S = 4.0
"""Of an input: beside the other tests a second of work may take several of a processor that is shared."""
INPUTS = 30
"""Damaged ones of a reader of weight 1."""


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_no_input_does_harm(name: str) -> None:
    reader = READERS[name]
    with Place(reader) as opened:
        fixed = numbered(opened)
        for data in opened.seeds.values():  # what is compiled meanwhile does not count
            with suppress(ValueError):
                opened.read(data)
        found = [judged(reader, opened, number, data, BUSY_CPU_S) for number, _, data in fixed]
        for number in range(max(2, round(INPUTS * reader.weight))):
            found.append(judged(reader, opened, number, made(reader, opened, number), BUSY_CPU_S))
    names = {number: own for number, own, _ in fixed}
    assert [
        f"{names.get(each.number, each.number)}: {each.what}: {each.detail}" for each in found if each
    ] == []
