"""The versions of a model folder: MODEL is in use, MODEL.versions/ holds those that it replaced.

Each is a whole model folder. A swap is a single step of the file system, and one writer changes a folder at
a time. A reader that was overtaken by a swap reads again (`folder.read_models`).
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from eigenscan.eigenspace.model import ModelError

MANIFEST = "manifest.json"
PROPOSAL = "proposal.json"
"""In a version that was never in use: the proposal, and in `since` the version that it is to replace."""
CHANGE = "change.json"
"""The same in a version that was accepted."""
KEPT = 5
"""Versions that are kept beside the one in use; the oldest goes first."""
_AT_CWD, _EXCHANGE = -100, 2
_NOT_SUPPORTED = {errno.ENOSYS, errno.EINVAL}
"""Of renameat2, where the kernel or the file system cannot exchange."""


@dataclass(frozen=True)
class Version:
    """A version on disk; `built`: s since the epoch; `proposed_for`: the version that it is to replace."""

    version: str
    folder: Path
    built: float
    regions: int
    free_area_m2: float
    wire_bytes: int
    proposed_for: str = ""


def place_of(folder: Path) -> Path:
    """Where a model folder is: a link leads there and stays one, whatever is swapped in."""
    return folder.resolve() if folder.is_symlink() else folder


def kept_in(folder: Path) -> Path:
    """The folder of the versions that `folder` replaced."""
    place = place_of(folder)
    return place.with_name(place.name + ".versions")


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Waits until no other writer changes `folder`. Has no effect on a file system without locks."""
    parent = os.open(place_of(folder).parent, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(parent, fcntl.LOCK_EX)
        yield
    finally:
        os.close(parent)


def versions(folder: Path) -> list[Version]:
    """The version in use, first, then the kept ones, the newest built first.

    Raises ModelError if `folder` holds no models. Other folders among the kept ones are skipped.
    """
    current = _describe(folder)
    if current is None:
        raise ModelError(f"{folder}: holds no models: build them with eigenscan build")
    found = [_describe(path) for path in _kept(folder)]
    others = {v.version: v for v in found if v is not None and v.version != current.version}
    return [current, *sorted(others.values(), key=lambda v: (-v.built, v.version))]


def choose(found: Sequence[Version], version: str | None, folder: Path) -> Version:
    """The kept version whose hash begins with `version`; without it, the newest before the one in use.

    `found`: the result of `versions`. Raises ModelError if none or several match.
    """
    current, *others = found
    kept = [v for v in others if not v.proposed_for]
    if version is None:
        older = [v for v in kept if v.built < current.built]
        if not older:
            newer = "; newer: " + ", ".join(v.version[:12] for v in kept) if kept else ""
            raise ModelError(f"{folder}: no older version is kept beside {current.version[:12]}{newer}")
        return older[0]
    return _named(kept, version, "those kept", folder)


def choose_proposal(found: Sequence[Version], version: str | None, folder: Path) -> Version:
    """The proposal whose hash begins with `version`, or the only one; else as `choose`.

    Also raises ModelError if it was made for another version than the one in use.
    """
    current, *others = found
    proposed = [v for v in others if v.proposed_for]
    if version is None and not proposed:
        raise ModelError(f"{folder}: no change is proposed: see eigenscan models list {folder}")
    chosen = _named(proposed, version or proposed[0].version, "those proposed", folder)
    if chosen.proposed_for != current.version:
        raise ModelError(
            f"{folder}: {chosen.version[:12]} was proposed for {chosen.proposed_for[:12]}, and "
            f"{current.version[:12]} is in use: wait for a new proposal"
        )
    return chosen


def _named(among: Sequence[Version], version: str, which: str, folder: Path) -> Version:
    matches = [v for v in among if version and v.version.startswith(version)]
    if len(matches) != 1:
        what = "names more than one" if matches else "is none"
        there = ", ".join(v.version[:12] for v in among) or "no other"
        raise ModelError(f"{folder}: version {version!r} {what} of {which}: there is {there}")
    return matches[0]


def accept(folder: Path, proposal: Path) -> None:
    """Puts the folder of a proposal in use, as `replace` does."""
    with alone(folder):
        (proposal / PROPOSAL).rename(proposal / CHANGE)
        put(folder, proposal)


def withdraw(folder: Path) -> None:
    """Deletes the proposals that are kept beside `folder`."""
    with alone(folder):
        for version in versions(folder)[1:]:
            if version.proposed_for:
                shutil.rmtree(version.folder)


def replace(folder: Path, fresh: Path) -> None:
    """Puts the model folder `fresh` in the place of `folder`, whose version is kept.

    Both must be on one file system, beside each other. Raises OSError if one of them is gone; then the other
    stays where it is.
    """
    with alone(folder):
        put(folder, fresh)


def put(folder: Path, fresh: Path) -> None:
    """As `replace`, for a writer that is `alone`."""
    folder = place_of(folder)
    exchange(fresh, folder)
    old, current = _describe(fresh), _describe(folder)
    store = kept_in(folder)
    if old is None or current is None or old.version == current.version:
        shutil.rmtree(fresh)
    else:
        store.mkdir(exist_ok=True)
        target = store / old.version[:12]
        if target != fresh:
            shutil.rmtree(target, ignore_errors=True)
            fresh.rename(target)
    _, *kept = versions(folder)
    live = {v.folder for v in kept if v.proposed_for}
    live |= {v.folder for v in [v for v in kept if not v.proposed_for][:KEPT]}
    for path in _kept(folder):
        if path not in live and _describe(path) is not None:
            shutil.rmtree(path)


def _kept(folder: Path) -> list[Path]:
    """The folders among the kept ones, but for those that are still being written."""
    return [path for path in kept_in(folder).glob("[!.]*") if path.is_dir()]


def exchange(one: Path, other: Path) -> None:
    """Swaps two folders of one file system, in a single step if the system can (Linux, renameat2).

    Raises OSError if it cannot, for instance if one of them is gone.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if hasattr(libc, "renameat2"):
        names = os.fsencode(one), os.fsencode(other)
        if libc.renameat2(_AT_CWD, names[0], _AT_CWD, names[1], _EXCHANGE) == 0:
            return
        if (code := ctypes.get_errno()) not in _NOT_SUPPORTED:
            raise OSError(code, os.strerror(code), str(one), None, str(other))
    aside = one.with_name(one.name + ".aside")
    other.rename(aside)
    try:
        one.rename(other)
    except OSError:
        aside.rename(other)
        raise
    aside.rename(one)


def _describe(folder: Path) -> Version | None:
    """A folder's version by its manifest; None if it is no model folder."""
    manifest = folder / MANIFEST
    try:
        published = json.loads(manifest.read_text(encoding="utf-8"))
        return Version(
            str(published["version"]),
            folder,
            manifest.stat().st_mtime,
            len(published["regions"]),
            float(published["free_area_m2"]),
            sum(int(entry["wire_bytes"]) for entry in published["regions"]),
            _proposed_for(folder / PROPOSAL),
        )
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def _proposed_for(proposal: Path) -> str:
    return str(json.loads(proposal.read_text(encoding="utf-8"))["since"]) if proposal.is_file() else ""
