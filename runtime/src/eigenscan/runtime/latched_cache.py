"""A cache of received maps and models on disk, for a start without the site.

Samples are read in the order of their arrival, so a core returns to its former state. The newest two of each
key are kept: the newest set may have been incomplete when the machine went down. Several services may share
a folder, as one setting for all of them has it.

A model that crashes its reader would do so at every start. So a start with cached samples is noted until it
has proven itself. After FAILED_STARTS that did not, all in the folder moves to its subfolder ASIDE.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

from eigenscan.runtime.inbox import Arrival
from eigenscan.schemas.channels import CHANNELS, Channel, find

GENERATIONS = 2
FAILED_STARTS = 2
"""In a row; one may be a power cut."""
ASIDE = "aside"
DIGEST_BYTES = 8
"""Length of the part of a sample's SHA-256 that identifies it in a query."""


def digest(payload: bytes) -> bytes:
    """Identifies a sample; DIGEST_BYTES long."""
    return hashlib.sha256(payload).digest()[:DIGEST_BYTES]


@dataclass(frozen=True)
class _Kept:
    """One file: `NUMBER-DIGEST-KEY`, the encoding and a line break before the payload."""

    path: Path
    number: int
    digest: str
    key: str

    @classmethod
    def of(cls, path: Path) -> _Kept | None:
        """From a file's name; None for another file."""
        number, _, rest = path.name.partition("-")
        hexadecimal, _, key = rest.partition("-")
        if not (number.isascii() and number.isdigit() and key):
            return None
        return cls(path, int(number), hexadecimal, unquote(key))


class LatchedCache:
    """A folder of samples. Raises OSError if it cannot be made."""

    def __init__(self, folder: Path, owner: str = "service") -> None:
        """`owner`: the service; others that share the folder have other names."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._starts, self._partial = folder / f"starts-{owner}", folder / f"partial-{owner}"
        named = (_Kept.of(path) for path in folder.iterdir())
        found = sorted((kept for kept in named if kept is not None), key=lambda kept: kept.number)
        self._kept: defaultdict[str, list[_Kept]] = defaultdict(list)
        for kept in found:
            self._kept[kept.key].append(kept)
        self._next = found[-1].number + 1 if found else 0
        self._read: set[tuple[str, str]] = set()
        """Key and digest of what was read, until its reader puts it."""

    def read(self, site: str, channels: Sequence[Channel] = CHANNELS) -> Iterator[Arrival]:
        """A site's samples of `channels`, oldest first; what is damaged or unreadable is forgotten."""
        everything = [kept for history in self._kept.values() for kept in history]
        for kept in sorted(everything, key=lambda kept: kept.number):
            found = find(kept.key)
            if found is None or found[1]["site"] != site or found[0] not in channels:
                continue
            try:
                encoding, _, payload = kept.path.read_bytes().partition(b"\n")
            except OSError:
                payload = None
            if payload is None or digest(payload).hex() != kept.digest:
                self._kept[kept.key].remove(kept)
                with suppress(OSError):
                    kept.path.unlink()
                continue
            self._read.add((kept.key, kept.digest))
            yield Arrival(found[0], kept.key, payload, encoding.decode(errors="replace"))

    def try_out(self) -> bool:
        """Notes a start with what is cached, until `prove`. Raises OSError.

        True if too many before this one failed: then all is set aside, and nothing is cached any more.
        """
        try:
            failed = int(self._starts.read_bytes())
        except (OSError, ValueError):  # none, or cut
            failed = 0
        if failed >= FAILED_STARTS:
            self._set_aside()
            return True
        self._starts.write_bytes(b"%d" % (failed + 1))
        return False

    def prove(self) -> None:
        """What is cached does no harm. Raises OSError."""
        self._starts.unlink(missing_ok=True)

    def _set_aside(self) -> None:
        aside = self._folder / ASIDE
        shutil.rmtree(aside, ignore_errors=True)
        aside.mkdir(exist_ok=True)
        for path in list(self._folder.iterdir()):
            if path not in (aside, self._starts):
                path.replace(aside / path.name)
        self._kept.clear()
        self._read.clear()
        self.prove()

    def put(self, sample: Arrival) -> None:
        """Writes a sample, unless it was read here or is already the newest of its key. Raises OSError."""
        history, known = self._kept[sample.key], digest(sample.payload).hex()
        if (sample.key, known) in self._read:  # written again, it would be newer than what came after it
            self._read.remove((sample.key, known))
            return
        if history and history[-1].digest == known:
            return
        name = f"{self._next:09d}-{known}-{quote(sample.key, safe='')}"
        try:
            with self._partial.open("wb") as file:
                file.write(sample.encoding.encode() + b"\n" + sample.payload)
                file.flush()
                os.fsync(file.fileno())
            self._partial.replace(self._folder / name)
        except OSError:  # a full disk needs the room
            with suppress(OSError):
                self._partial.unlink()
            raise
        history.append(_Kept(self._folder / name, self._next, known, sample.key))
        self._next += 1
        while len(history) > GENERATIONS:
            history.pop(0).path.unlink(missing_ok=True)
