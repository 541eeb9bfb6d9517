"""Answers queries for a robot's recordings: the list of files, and pieces of them."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import zenoh
from eigenscan.recorder.files import Files
from eigenscan.runtime.recording import RecordingError, closed_span, first_time
from eigenscan.schemas.channels import MOST_RECORDED_BYTES, RECORDINGS_TEMPLATE
from eigenscan.schemas.recordings_pb2 import RecordingPart, RecordingParts, RecordingRequest
from google.protobuf.message import DecodeError


class Uploads:
    """Answers queries for the files of one recorder. It reads; nothing that is asked changes a file."""

    def __init__(self, files: Files) -> None:
        self._files = files
        self._closed: dict[tuple[str, int, int], RecordingPart] = {}
        self._declared: list[Any] = []

    def offer(self, session: zenoh.Session, site: str, robot: str) -> None:
        """Answers on the robot's key for as long as the session is open."""
        key = RECORDINGS_TEMPLATE.format(site=site, robot=robot, what="*")
        self._declared.append(session.declare_queryable(key, self._on_query, complete=True))

    def answer(self, what: str, payload: bytes) -> bytes:
        """The answer to a query for `what`. Raises RecordingError if there is none, or OSError."""
        if what == "parts":
            return self.parts().SerializeToString()
        if what == "bytes":
            try:
                return self.read(RecordingRequest.FromString(payload))
            except DecodeError as error:
                raise RecordingError("the query's payload is no eigenscan.RecordingRequest") from error
        raise RecordingError(f"{what!r} is not known: ask for parts or bytes")

    def parts(self) -> RecordingParts:
        """The files, oldest first, without other files and those deleted meanwhile."""
        found: list[RecordingPart] = []
        for path in self._files.own():
            with suppress(OSError, RecordingError):
                found.append(self._part(path))
        seen = {(one.name, one.size) for one in found}
        self._closed = {key: part for key, part in self._closed.items() if key[:2] in seen}
        found.sort(key=lambda one: (one.begin_ns, one.name))
        return RecordingParts(parts=found)

    def read(self, request: RecordingRequest) -> bytes:
        """The requested bytes, fewer at the file's end, at most MOST_RECORDED_BYTES.

        Raises RecordingError if this recorder has no such file, or OSError.
        """
        path = next((one for one in self._files.own() if one.name == request.name), None)
        if path is None:
            raise RecordingError(f"{request.name}: is not there (any more): old files make room for new ones")
        with path.open("rb") as file:
            if request.offset >= file.seek(0, 2):  # an offset beyond any file cannot be sought
                return b""
            file.seek(request.offset)
            return file.read(min(request.length, MOST_RECORDED_BYTES))

    def _part(self, path: Path) -> RecordingPart:
        stat = path.stat()
        key = path.name, stat.st_size, stat.st_mtime_ns
        if key in self._closed:
            return self._closed[key]
        span = closed_span(path)
        if span is not None:
            part = RecordingPart(
                name=path.name, size=stat.st_size, begin_ns=span[0], end_ns=span[1], closed=True
            )
            self._closed[key] = part
            return part
        begin = first_time(path)
        return RecordingPart(
            name=path.name,
            size=stat.st_size,
            begin_ns=stat.st_mtime_ns if begin is None else begin,
            end_ns=stat.st_mtime_ns,
        )

    def _on_query(self, query: Any) -> None:
        with query, suppress(zenoh.ZError):  # the asker is gone
            what = str(query.key_expr).rpartition("/")[2]
            payload = query.payload.to_bytes() if query.payload is not None else b""
            try:
                query.reply(query.key_expr, self.answer(what, payload))
            except OSError as error:
                query.reply_err(f"{error.filename}: {error.strerror}")
            except ValueError as error:  # RecordingError, and any other value error of a query
                query.reply_err(str(error))
