"""The live viewer in a real browser: what each layout is for is really seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path

import pytest
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.picture.layout import Layout
from eigenscan.recorder.picture.palette import AMBIGUOUS, HYPOTHESIS, LOCALIZED, PLACE, SCAN, TRACK
from eigenscan.recorder.rerun_sink import RerunSink
from eigenscan.schemas.channels import HEALTH
from eigenscan.schemas.envelope import Envelope

from tests.browser.chromium import Pixels, open_page, screenshot_when, share
from tests.services.recorder.traffic import Site

WIDTH, HEIGHT = 1280, 720
TOP_PX = 30
"""Of the viewer's own menu."""
WHITE, BLACK = (255, 255, 255), (0, 0, 0)


def bar(pixels: Pixels) -> Pixels:
    return pixels[TOP_PX : TOP_PX + 50, 200:1080]


def floor(pixels: Pixels) -> Pixels:
    return pixels[130 : HEIGHT - 40, : WIDTH * 7 // 11]


def shows_operator(pixels: Pixels) -> bool:
    """Green bar with words on it; white rooms, black walls and a blue scan."""
    return (
        share(bar(pixels), LOCALIZED) > 0.4
        and share(bar(pixels), WHITE) > 0.005
        and share(floor(pixels), WHITE) > 0.1
        and share(floor(pixels), BLACK) > 0.01
        and share(floor(pixels), SCAN, tolerance=30) > 0.0002
    )


def shows_researcher(pixels: Pixels) -> bool:
    """A pale cloud and an orange loop in the eigenspace; a blue scan, its reconstruction, eigen-scans."""
    space, curves = pixels[120:480, : WIDTH // 2], pixels[120:400, WIDTH * 6 // 11 :]
    return (
        share(space, PLACE, tolerance=20) > 0.002
        and share(space, HYPOTHESIS, tolerance=30) > 0.0005
        and share(curves, SCAN, tolerance=30) > 0.0005
        and share(curves, HYPOTHESIS, tolerance=30) > 0.0005
        and share(curves, TRACK, tolerance=30) > 0.002
    )


def shows_fleet(pixels: Pixels) -> bool:
    """Green and amber fields on the board; robots in both colours on the floor, and nobody's scan."""
    board, below = pixels[TOP_PX:220], pixels[260 : HEIGHT - 40, : WIDTH * 7 // 11]
    return (
        share(board, LOCALIZED) > 0.05
        and share(board, AMBIGUOUS) > 0.005
        and share(below, LOCALIZED) > 0.001
        and share(below, AMBIGUOUS) > 0.0001
        and share(below, SCAN, tolerance=30) == 0
    )


def few() -> Iterator[Envelope]:
    return Site("s", seconds=4.0).messages()


def many() -> Iterator[Envelope]:
    """Eight robots side by side, of which one stays in doubt."""
    each = [list(Site("s", f"r{number}", seconds=4.0, seed=number).messages()) for number in range(8)]
    each[0] = each[0][: len(each[0]) * 2 // 5]
    for together in zip_longest(*each):
        yield from (message for message in together if message is not None)


@pytest.mark.browser
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("layout", "traffic", "is_shown"),
    [
        ("operator", few, shows_operator),
        ("researcher", few, shows_researcher),
        ("fleet", many, shows_fleet),
    ],
)
def test_a_layout_shows_what_it_is_for(
    layout: Layout,
    traffic: Callable[[], Iterator[Envelope]],
    is_shown: Callable[[Pixels], bool],
    tmp_path: Path,
) -> None:
    sink = RerunSink(RecorderOptions(viewer_port=0, data_port=0, picture_hz=2, layout=layout))
    for message in traffic():
        if message.channel != HEALTH:
            sink.write(message)
    sink.flush()
    try:
        with open_page(sink.url, WIDTH, HEIGHT) as page:
            screenshot_when(page, is_shown, tmp_path / "viewer.png", patience_s=400)
    finally:
        sink.close()
