"""Text from elsewhere, made safe to show on a terminal."""

from __future__ import annotations

import unicodedata

MOST = 2000
"""Characters of one text that are shown: an error message may quote a whole file."""


def printable(text: str) -> str:
    """`text` in one line, without what a terminal obeys (control and format characters), cut to MOST."""
    shown = " ".join(text[: 2 * MOST].split())
    # Cc: escape sequences; Cf: marks that turn the order of the text around; Cs: bytes that are no UTF-8
    shown = "".join("?" if unicodedata.category(each) in ("Cc", "Cf", "Cs") else each for each in shown)
    return shortened(shown, MOST)


def shortened(text: str, most: int) -> str:
    """`text` of at most so many characters, and a mark where it is cut."""
    return text if len(text) <= most else f"{text[:most]}…"


def in_link(host: str) -> str:
    """A host as links have it: an IPv6 address in brackets (RFC 3986, 3.2.2)."""
    return f"[{host}]" if ":" in host else host
