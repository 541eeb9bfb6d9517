"""Errors that name the fix, in one line."""

from __future__ import annotations

from errno import EDQUOT, EFBIG, EIO, ENOSPC, EROFS

from eigenscan.runtime.printable import printable


class UsageError(ValueError):
    """A request that cannot be done; the message names the option or file and the fix."""


class FailedError(RuntimeError):
    """A valid request failed; the message gives the reason."""


class StoppedError(KeyboardInterrupt):
    """Ctrl-C; the message gives what was done before it."""


def signal_within(error: BaseException | None) -> BaseException | None:
    """What a signal's handler raised, if it did; within compiled code Python has SystemErrors over it."""
    while isinstance(error, SystemError):
        error = error.__cause__
    return error if isinstance(error, KeyboardInterrupt | SystemExit) else None


def by_users(error: Exception) -> bool:
    """Whether `error` is about the input, and so needs no trace.

    These are the errors that this project raises itself (SettingsError, MapError, ...) and files that
    cannot be read or written.
    """
    if isinstance(error, OSError):
        return error.filename is not None
    return isinstance(error, ValueError) and type(error).__module__.startswith("eigenscan.")


_FIXES_BY_NUMBER = {
    ENOSPC: ": make room, or name another place",
    EDQUOT: ": make room, or name another place",
    EFBIG: ": raise the limit (ulimit -f), or name another place",
    EROFS: ": name another place",
    EIO: ": does the disk fail? Copy what can be read to another one",
}
_FIXES: dict[type[OSError], str] = {
    FileNotFoundError: ": check the path",
    PermissionError: ": change the file's rights, or name another place",
    IsADirectoryError: ": name a file",
    NotADirectoryError: ": name a folder",
}


def fix_of(error: OSError, other: str = "") -> str:
    """What mends a failure to read or write a file, after a colon; `other` where nothing better is known."""
    return _FIXES_BY_NUMBER.get(error.errno or 0) or _FIXES.get(type(error), other)


def one_line(error: Exception) -> str:
    """The error in one line that a terminal can show."""
    if isinstance(error, OSError) and error.filename is not None:
        return printable(f"{error.filename}: {error.strerror}{fix_of(error)}")
    return printable(str(error)) or type(error).__name__
