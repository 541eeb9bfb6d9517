"""The site is whole: no warning, no dead link, no page that the menu lacks."""

import os
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

from tests.docs.code_blocks import pages
from tests.environment import ROOT


class _Links(HTMLParser):
    """What a page refers to, and the places in it that can be referred to."""

    def __init__(self) -> None:
        super().__init__()
        self.links: set[str] = set()
        self.places: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        named = dict(attrs)
        self.places |= {value for name in ("id", "name") if (value := named.get(name))}
        self.links |= {value for name in ("href", "src") if (value := named.get(name))}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> dict[Path, _Links]:
    """Every page of the site that was built, and what it refers to."""
    folder = tmp_path_factory.mktemp("site") / "site"
    command = [str(Path(sys.executable).with_name("mkdocs")), "build", "--quiet", "--strict"]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(
        [*command, "--site-dir", str(folder)],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert built.returncode == 0, built.stdout + built.stderr
    found = {}
    for page in folder.rglob("*.html"):
        found[page] = _Links()
        found[page].feed(page.read_text(encoding="utf-8"))
    return found


def test_every_link_leads_somewhere(site: dict[Path, _Links]) -> None:
    dead, followed = set(), 0
    for page, own in site.items():
        for link in own.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or page.name == "404.html":
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            followed += 1
            if not target.exists():
                dead.add(f"{page.name}: {link}")
            elif parts.fragment and target in site and unquote(parts.fragment) not in site[target].places:
                dead.add(f"{page.name}: {link}: no such place")
    assert not dead
    assert followed > 500


def test_the_site_has_its_style_and_search(site: dict[Path, _Links]) -> None:
    (index,) = (
        own for page, own in site.items() if page.name == "index.html" and (page.parent / "docs").is_dir()
    )
    assert any(link.endswith(".css") for link in index.links)
    assert any(link.endswith(".js") for link in index.links)
    assert not [link for link in index.links if "fonts.g" in link]


def test_every_page_is_in_the_menu(site: dict[Path, _Links]) -> None:
    (index,) = (
        own for page, own in site.items() if page.name == "index.html" and (page.parent / "docs").is_dir()
    )
    wanted = {page.replace("README.md", "index.html").replace(".md", ".html") for page in pages()}
    missing = wanted - {link.partition("#")[0] for link in index.links} - {"index.html"}
    assert not missing
