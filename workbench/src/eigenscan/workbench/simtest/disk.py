"""A disk in memory, behind paths: it can be full, tear writes, lose what was not synced, end processes."""

from __future__ import annotations

import errno
import fnmatch
import io
import math
import os
import stat as modes
from collections.abc import Callable, Iterator
from pathlib import Path, PosixPath
from random import Random
from typing import IO, Any, ClassVar

from eigenscan.workbench.simtest.agenda import MachineClock

WRITTEN_BACK_S = 35.0
"""By which Linux has written what it was handed: it is old after 30 s, and looked at every 5 s."""


class KilledError(BaseException):
    """The process ends here, in the midst of what it does."""


class _Inode:
    """What a name stands for."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.data = bytearray()
        self.synced = 0
        self.grown: list[tuple[float, int]] = []
        """When it was how long."""
        self.mtime_ns = 0
        self.lock: int | None = None


class Disk:
    """The files of one process, which outlive it."""

    def __init__(self, clock: MachineClock) -> None:
        self._clock = clock
        self.files: dict[str, _Inode] = {}
        self.folders: set[str] = {"/"}
        self.left: int | None = None
        """Bytes until it is full; None: it will not be."""
        self.kill_at: int | None = None
        """So many more operations, and the process is killed in the midst of one."""
        self._numbers = 0
        self._open: list[_Raw] = []

        class OnDisk(SimPath):
            disk = self

        self.path: Callable[[str], Path] = OnDisk

    def step(self) -> None:
        """One operation. Raises KilledError where it is the last."""
        if self.kill_at is not None:
            self.kill_at -= 1
            if self.kill_at < 0:
                raise KilledError

    def room(self, size: int) -> int:
        """Bytes of `size` that can be written, at least one. Raises OSError where none can."""
        if self.left is None:
            return size
        size = min(size, self.left)
        if size == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.left -= size
        return size

    def create(self, name: str) -> _Inode:
        """An empty file in the place of whatever was there."""
        self._numbers += 1
        inode = self.files[name] = _Inode(self._numbers)
        inode.mtime_ns = self._clock.time_ns()
        return inode

    def open(self, raw: _Raw) -> None:
        """Notes an open file."""
        self._open.append(raw)

    def note(self, inode: _Inode) -> None:
        """It was written to."""
        inode.mtime_ns = self._clock.time_ns()
        inode.grown.append((self._clock.monotonic(), len(inode.data)))

    def end_process(self) -> None:
        """Whatever the process has not handed to the operating system is gone."""
        for raw in self._open:
            raw.die()
        self._open.clear()
        self.kill_at = None

    def lose_power(self, random: Random) -> None:
        """Of what was not synced only a part is there afterwards."""
        self.end_process()
        old = self._clock.monotonic() - WRITTEN_BACK_S
        for inode in self.files.values():
            safe = max([inode.synced, *(size for at, size in inode.grown if at <= old)])
            kept = random.randint(min(safe, len(inode.data)), len(inode.data))
            del inode.data[kept:]
            inode.grown = [(-math.inf, kept)]

    def close(self) -> None:
        """Frees what the operating system holds for it."""
        self.end_process()
        for inode in self.files.values():
            if inode.lock is not None:
                os.close(inode.lock)
                inode.lock = None


class _Raw(io.RawIOBase):
    """An open file."""

    def __init__(self, disk: Disk, inode: _Inode, writes: bool) -> None:
        self._disk, self._inode, self._writes = disk, inode, writes
        self._at = 0
        self._is_dead = False
        self._descriptor: int | None = None
        disk.open(self)

    def readable(self) -> bool:
        return not self._writes

    def writable(self) -> bool:
        return self._writes

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        base = (0, self._at, len(self._inode.data))[whence]
        if base + offset < 0:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        self._at = base + offset
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        piece = self._inode.data[self._at : self._at + len(buffer)]
        buffer[: len(piece)] = piece
        self._at += len(piece)
        return len(piece)

    def write(self, data: Any) -> int:
        if self._is_dead:  # Python empties the buffers of a process that is no more
            return len(data)
        try:
            self._disk.step()
        except KilledError:  # in the midst of it
            self._put(bytes(data)[: len(data) // 2])
            raise
        size = self._disk.room(len(data))
        self._put(bytes(data)[:size])
        return size

    def _put(self, data: bytes) -> None:
        self._inode.data[self._at : self._at + len(data)] = data
        self._at += len(data)
        self._disk.note(self._inode)

    def fileno(self) -> int:
        """One that can be locked. It is asked for to lock a new file, and to sync: then all is safe."""
        if self._inode.lock is None:
            self._inode.lock = os.memfd_create("simulated")
        if self._descriptor is None:
            self._descriptor = os.open(f"/proc/self/fd/{self._inode.lock}", os.O_RDWR)
        self._inode.synced = len(self._inode.data)
        return self._descriptor

    def close(self) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None
        super().close()

    def die(self) -> None:
        """The process that has it open is gone."""
        self._is_dead = True
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


class SimPath(PosixPath):
    """A path on a simulated disk."""

    disk: ClassVar[Disk]

    def stat(self, **_: Any) -> os.stat_result:
        """Kind, number, size and time."""
        name = str(self)
        if name in self.disk.folders:
            return os.stat_result((modes.S_IFDIR | 0o755, 0, 0, 1, 0, 0, 0, 0, 0, 0))
        inode = self.disk.files.get(name)
        if inode is None:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), name)
        seconds = inode.mtime_ns // 1_000_000_000
        plain = (modes.S_IFREG | 0o644, inode.number, 0, 1, 0, 0, len(inode.data), seconds, seconds, seconds)
        return os.stat_result(plain, {"st_mtime_ns": inode.mtime_ns})

    def exists(self, **_: Any) -> bool:
        """Whether there is a file or a folder."""
        return str(self) in self.disk.files or str(self) in self.disk.folders

    def is_dir(self, **_: Any) -> bool:
        """Whether there is a folder."""
        return str(self) in self.disk.folders

    def is_file(self, **_: Any) -> bool:
        """Whether there is a file."""
        return str(self) in self.disk.files

    def open(self, mode: str = "r", *_: Any, **__: Any) -> IO[Any]:  # type: ignore[override]
        """`rb` or `wb`."""
        self.disk.step()
        name = str(self)
        if mode == "rb":
            if name not in self.disk.files:
                raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), name)
            return io.BufferedReader(_Raw(self.disk, self.disk.files[name], writes=False))
        if mode != "wb":
            raise ValueError(f"mode {mode}: a simulated disk knows rb and wb")
        if str(self.parent) not in self.disk.folders:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), name)
        return io.BufferedWriter(_Raw(self.disk, self.disk.create(name), writes=True))

    def mkdir(self, *_: Any, **__: Any) -> None:
        """Makes the folder, and those above it."""
        self.disk.folders.update(str(folder) for folder in (self, *self.parents))

    def iterdir(self) -> Iterator[SimPath]:  # type: ignore[override]
        """The files of a folder."""
        return iter([path for path in map(type(self), self.disk.files) if path.parent == self])

    def glob(self, pattern: str, **_: Any) -> Iterator[SimPath]:  # type: ignore[override]
        """The files of a folder whose names fit."""
        return iter([path for path in self.iterdir() if fnmatch.fnmatchcase(path.name, pattern)])

    def touch(self, mode: int = 0o666, exist_ok: bool = True) -> None:  # noqa: ARG002 - as pathlib has it
        """Makes an empty file."""
        self.disk.step()
        if not self.exists():
            self.disk.create(str(self))
        elif not exist_ok:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(self))

    def unlink(self, missing_ok: bool = False) -> None:
        """Deletes a file."""
        self.disk.step()
        if self.disk.files.pop(str(self), None) is None and not missing_ok:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(self))

    def replace(self, target: Any) -> SimPath:
        """Gives a file another name."""
        self.disk.step()
        self.disk.files[str(target)] = self.disk.files.pop(str(self))
        return type(self)(target)
