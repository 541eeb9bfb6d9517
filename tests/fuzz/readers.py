"""Every reader of what others wrote, with sound inputs made here and attacks that were made to do harm."""

from __future__ import annotations

from tests.fuzz.cores import CORES
from tests.fuzz.files import FILES
from tests.fuzz.reader import Reader

READERS: dict[str, Reader] = {reader.name: reader for reader in (*FILES, *CORES)}
