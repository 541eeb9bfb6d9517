"""Former ways to type a command, accepted for one release."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from eigenscan.runtime.errors import UsageError

REPLAY_OPTIONS = ("--service", "--compare", "--set", "--tolerant", "--strict", "--ignore", "--rrd", "--model")


def positional(name: str, given: Path | None, former: Path | None) -> Path:
    """The argument `name`, or its former option. Raises UsageError if neither or both are given."""
    if (given is None) == (former is None):
        raise UsageError(f"{name} is {'missing' if given is None else 'given twice'}: see --help")
    found = given if given is not None else former
    assert found is not None
    return found


def optional(name: str, given: Path | None, former: Path | None) -> Path | None:
    """The argument `name`, its former option, or neither. Raises UsageError if both are given."""
    return None if given is None and former is None else positional(name, given, former)


def current(name: str, arguments: Sequence[str]) -> str:
    """The command that `name` means with these arguments: `replay` without a service was today's `play`."""
    own = {each.partition("=")[0] for each in arguments}
    asks_for_replay = own.intersection((*REPLAY_OPTIONS, "--help", "--help-all")) or not own
    return "play" if name == "replay" and not asks_for_replay else name
