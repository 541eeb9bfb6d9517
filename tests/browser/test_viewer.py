"""The live viewer in a real browser: the operator's bar, and the map with the scan on it, are seen."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from eigenscan.recorder.picture.palette import LOCALIZED, SCAN
from eigenscan.recorder.rerun_sink import RerunSink
from eigenscan.recorder.settings import RecorderSettings
from eigenscan.schemas.channels import HEALTH

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "recorder")]

from chromium import Pixels, open_page, screenshot_when, share  # noqa: E402
from traffic import Site  # noqa: E402

WIDTH, HEIGHT = 1280, 720
TOP_PX = 30
"""Of the viewer's own menu."""
WHITE, BLACK = (255, 255, 255), (0, 0, 0)


def bar(pixels: Pixels) -> Pixels:
    return pixels[TOP_PX : TOP_PX + 50, 200:1080]


def floor(pixels: Pixels) -> Pixels:
    return pixels[130 : HEIGHT - 40, : WIDTH * 7 // 11]


def is_drawn(pixels: Pixels) -> bool:
    """Green bar with words on it; white rooms, black walls and a blue scan."""
    return (
        share(bar(pixels), LOCALIZED) > 0.4
        and share(bar(pixels), WHITE) > 0.005
        and share(floor(pixels), WHITE) > 0.1
        and share(floor(pixels), BLACK) > 0.01
        and share(floor(pixels), SCAN, tolerance=30) > 0.0002
    )


@pytest.mark.browser
@pytest.mark.timeout(600)
def test_the_operator_sees_state_map_and_scan(tmp_path: Path) -> None:
    sink = RerunSink(RecorderSettings(viewer_port=0, data_port=0, picture_hz=2))
    messages = list(Site("s", seconds=4.0).messages())
    for message in messages:
        if message.channel != HEALTH:
            sink.write(message)
    sink.flush()
    try:
        with open_page(sink.url, WIDTH, HEIGHT) as page:
            screenshot_when(page, is_drawn, tmp_path / "viewer.png", patience_s=400)
    finally:
        sink.close()
