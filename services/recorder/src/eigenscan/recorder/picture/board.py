"""The board as an image: a bar or, for many robots, a field for each; those in need come first."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.recorder.picture.palette import Colour
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

BAR_PX = (1000, 46)
FIELD_PX = (240, 30)
ASPECT = 6.2
"""Width over height of the panel of many robots on a usual screen."""
MOST_BARS = 6
"""Robots that get a bar each."""
SUMMARY: Colour = (30, 30, 30)


@dataclass(frozen=True)
class Line:
    """A robot's entry on the board. `urgency`: entries with a greater one come first."""

    robot: str
    state: str
    urgency: int
    colour: Colour
    sureness: str
    advice: str


def shown(lines: Sequence[Line]) -> list[Line]:
    """The lines in the board's order; many robots are shown without figures."""
    if len(lines) <= MOST_BARS:
        return list(lines)
    brief = (Line(line.robot, line.state, line.urgency, line.colour, "", "") for line in lines)
    return sorted(brief, key=lambda line: (-line.urgency, _by_number(line.robot)))


def _by_number(name: str) -> list[tuple[int, str]]:
    """Sorts r2 before r10: texts as they are, numbers by their length first."""
    parts = [part.lstrip("0") if part.isdecimal() else part for part in re.split(r"(\d+)", name)]
    return [(len(part) if number % 2 else 0, part) for number, part in enumerate(parts)]


def draw_board(lines: Sequence[Line]) -> NDArray[np.uint8]:
    """The image (h, w, 3) of the lines of `shown`."""
    return _bars(lines) if len(lines) <= MOST_BARS else _fields(lines)


def _bars(lines: Sequence[Line]) -> NDArray[np.uint8]:
    width, height = BAR_PX
    image = Image.new("RGB", (width, height * len(lines)))
    pen = ImageDraw.Draw(image)
    title, detail = ImageFont.load_default(26), ImageFont.load_default(16)
    for row, line in enumerate(lines):
        top = row * height
        pen.rectangle((0, top, width, top + height - 3), fill=line.colour)
        words = f"{line.robot}: {line.state}   {line.sureness}".rstrip()
        pen.text((14, top + 22), words, font=title, fill="white", anchor="lm")
        pen.text((width - 14, top + 22), line.advice, font=detail, fill="white", anchor="rm")
    return np.asarray(image)


def _rows(robots: int, columns: int) -> int:
    """Rows of fields, with the summary."""
    return 1 + -(-robots // columns)


def _columns(robots: int) -> int:
    """The fields a row with which they are largest in the panel."""
    width, height = FIELD_PX
    return max(
        range(1, robots + 1),
        key=lambda columns: min(ASPECT / (width * columns), 1.0 / (height * _rows(robots, columns))),
    )


def _fields(lines: Sequence[Line]) -> NDArray[np.uint8]:
    width, height = FIELD_PX
    columns = _columns(len(lines))
    image = Image.new("RGB", (width * columns, height * _rows(len(lines), columns)), SUMMARY)
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(18)
    counts = Counter(line.state for line in lines)
    words = ", ".join(f"{counts[state]} {state}" for state in dict.fromkeys(line.state for line in lines))
    pen.text((8, height // 2), f"{len(lines)} robots: {words}", font=font, fill="white", anchor="lm")
    for number, line in enumerate(lines):
        row, column = divmod(number, columns)
        left, top = column * width, (row + 1) * height
        pen.rectangle((left, top, left + width - 3, top + height - 3), fill=line.colour)
        pen.text((left + 8, top + 14), f"{line.robot}: {line.state}", font=font, fill="white", anchor="lm")
    return np.asarray(image)
