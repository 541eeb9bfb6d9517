"""A headless Chromium, Debian's own, that draws WebGL in software; and what a screenshot shows."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Page, sync_playwright

FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
]
POLL_S = 2.0

Pixels = NDArray[np.uint8]
Theme = Literal["light", "dark"]


def find_chromium() -> str:
    """Path of the browser; installs it where it is missing and that is allowed."""
    found = shutil.which("chromium")
    if found is None and os.geteuid() == 0 and shutil.which("apt-get"):
        environment = os.environ | {"DEBIAN_FRONTEND": "noninteractive"}
        for arguments in (["update", "-qq"], ["install", "-y", "-qq", "--no-install-recommends", "chromium"]):
            subprocess.run(
                ["apt-get", "-o", "Acquire::Retries=5", *arguments],
                env=environment,
                check=True,
                stdout=subprocess.DEVNULL,
            )
        found = shutil.which("chromium")
    if found is None:
        raise RuntimeError("chromium is missing: install it (Debian: apt-get install chromium)")
    return found


@contextmanager
def open_page(link: str, width: int, height: int, theme: Theme = "light") -> Iterator[Page]:
    """The page behind a viewer's link, in the theme that the user's system asks for."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=FLAGS)
        try:
            page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=theme)
            page.goto(f"{link}&renderer=webgl")
            yield page
        finally:
            browser.close()


def screenshot_when(
    page: Page, shows: Callable[[Pixels], bool], target: Path, patience_s: float = 180.0
) -> Pixels:
    """The first screenshot (h, w, 3) that shows what is wanted, kept as `target`.

    The last one is kept, and TimeoutError raised, where it never does: software takes seconds for a frame.
    """
    deadline = time.monotonic() + patience_s
    while True:
        content = page.screenshot(timeout=patience_s * 1000)
        pixels = np.asarray(Image.open(BytesIO(content)).convert("RGB"))
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        if shows(pixels):
            return pixels
        if time.monotonic() > deadline:
            raise TimeoutError(f"not seen within {patience_s:g} s; see {target}")
        time.sleep(POLL_S)


def share(pixels: Pixels, colour: tuple[int, int, int], tolerance: int = 12) -> float:
    """Share of the pixels that have `colour`."""
    near = np.abs(pixels.astype(np.int16) - np.array(colour, dtype=np.int16)).max(axis=-1) <= tolerance
    return float(near.mean())
