"""All traffic to MCAP files, through full disks and kills."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter

from eigenscan.recorder.about import About
from eigenscan.recorder.core import Sink
from eigenscan.recorder.files import Files, Limits
from eigenscan.runtime.logs import logger
from eigenscan.runtime.recording import STEP_NS, RecordingWriter, stamp_of
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.wire import encode

RETRY_S = 10.0
"""After a failed write a new file is tried this often."""

SLOW_S = 0.1
"""A write that takes longer is back-pressure of the disk."""

SHOWN_S = 60.0
"""How long health reports that the file was deleted."""


class McapSink(Sink):
    """Writes to a new file in the folder `target`, or to `target` itself if it ends in .mcap.

    An existing file is left alone: the next free one of `name-2.mcap`, `name-3.mcap` is used. Messages older
    than `flush_s` are written to the operating system; after the last message that takes up to a second. A
    file at its limits is closed and the next one begun; if all take too much, the oldest are deleted. If the
    disk fails, messages count as lost, and a new file is tried every RETRY_S. Each file starts with the
    newest latched messages, so that it is complete, and ends with the services' metadata. A file with as many
    keys as MCAP can number is closed too, and one that somebody has deleted or moved.
    """

    def __init__(
        self,
        target: Path,
        site: str,
        clock: Callable[[], int],
        flush_s: float,
        metadata: Mapping[str, Mapping[str, str]],
        limits: Limits | None = None,
        stopwatch: Callable[[], float] = perf_counter,
    ) -> None:
        """Opens the file. `clock` gives ns since the epoch. Raises OSError where that is impossible."""
        self._clock, self._metadata, self._limits = clock, metadata, limits or Limits()
        self._stopwatch = stopwatch
        self._files = Files(target, site)
        self._flush_ns = int(flush_s * 1e9)
        self._latched: dict[str, Envelope] = {}
        self._about = About()
        self._counts: Counter[str] = Counter(mcap_slow=0)
        self._slowest_s = 0.0
        self._problem = self._gone = ""
        self._gone_at = 0
        self._retry_at = 0
        self._pending = 0
        self._now = self._flushed_at = clock()
        self._writer: RecordingWriter | None = self._begin(self._flushed_at)

    @property
    def path(self) -> Path | None:
        """The file in use; None if there is none."""
        return self._writer.path if self._writer else None

    @property
    def problem(self) -> str:
        """Why nothing is written now.

        It does not tell how much is lost, as `mcap_lost` does: each change of it is published and logged.
        """
        if self._problem:
            return f"{self._problem}; messages are lost"
        return self._gone if self._now - self._gone_at < SHOWN_S * 1e9 else ""

    @property
    def remark(self) -> str:
        """How many messages it has lost."""
        lost = self._counts["mcap_lost"]
        return f"mcap: {lost} messages were lost: the disk was full, or a file deleted" if lost else ""

    @property
    def counters(self) -> Mapping[str, int]:
        """`mcap_written` (flushed), `_lost`, `_files`, `_deleted`, `_clock_set_back`.

        Of writes `_slow` and `_slowest_ms`.
        """
        return self._counts

    def write(self, received: Envelope) -> None:
        """Adds a message: log time is that of its arrival, publish time the message's own stamp."""
        now, before, key = received.arrived or self._clock(), self._stopwatch(), received.key
        if now < self._now:
            self._follow_back(now)
        self._now = now
        try:
            self._pending += 1
            writer = self._rotated(now, key) if self._writer else self._reopen(now)
            if writer is None:
                self._settle("mcap_lost")
            else:
                payload = received.payload or encode(received.message)
                writer.write_bytes(received.channel, key, payload, now, stamp_of(received) or now)
                self._flush(writer, now)
        except Exception as error:  # for any error, the next messages must not be lost too
            self._fail(error, now)
        if received.channel.qos.latched:
            self._latched[key] = received
        self._about.receive(received)
        self._note_pace(self._stopwatch() - before)

    def tick(self) -> None:
        """Writes due messages, also if no more arrive."""
        now = self._clock()
        if self._writer is not None and self._pending:
            try:
                self._flush(self._writer, now)
            except Exception as error:
                self._fail(error, now)

    def close(self) -> None:
        """Writes the index."""
        if self._writer is not None:
            try:
                self._writer.close(self._about.metadata)
                self._settle("mcap_written")
            except Exception as error:
                self._fail(error, self._clock())
                logger().error("mcap_not_closed", detail=self._problem, lost=self._counts["mcap_lost"])
            self._writer = None

    def _follow_back(self, now: int) -> None:
        """After the clock was set back, moves the due times back too."""
        back = self._now - now
        if back > STEP_NS:  # by less, two threads that received at once
            self._counts["mcap_clock_set_back"] += 1
        self._flushed_at -= back
        self._opened_at -= back
        self._retry_at -= back
        self._gone_at -= back

    def _flush(self, writer: RecordingWriter, now: int) -> None:
        # a tick may have flushed by a clock that was set back since
        if abs(now - self._flushed_at) >= self._flush_ns:
            self._flushed_at = now
            writer.flush()
            self._settle("mcap_written")
            self._is_gone = not writer.is_there

    def _settle(self, what: str, but: int = 0) -> None:
        """Counts what came since the last flush, `but` the newest: until then a full disk may lose it."""
        self._counts[what] += self._pending - but
        self._pending = but

    def _note_pace(self, took_s: float) -> None:
        if took_s > self._slowest_s:
            self._slowest_s, self._counts["mcap_slowest_ms"] = took_s, int(took_s * 1e3)
        if took_s > SLOW_S:
            self._counts["mcap_slow"] += 1

    def _fail(self, error: Exception, now: int) -> None:
        where, reason = self.path or self._files.target, getattr(error, "strerror", None)
        mend = "free space or change mcap" if reason else "a new file begins; report it with the recording"
        self._problem = f"mcap: {where}: {reason or f'{type(error).__name__}: {error}'}: {mend}"
        self._retry_at = now + int(RETRY_S * 1e9)
        self._settle("mcap_lost")
        if self._writer is not None:
            self._writer.abandon()
            self._writer = None

    def _rotated(self, now: int, key: str) -> RecordingWriter | None:
        """The file in use, or the next one if it is at its limits, has no number for `key`, or is gone."""
        if self._writer and (
            self._limits.is_full(self._writer.size, self._head, now - self._opened_at)
            or not self._writer.has_room(key)
            or self._is_gone
        ):
            if self._is_gone:
                self._note_gone(self._writer, now)
            self._writer.close(self._about.metadata)
            self._settle("mcap_written", but=1)
            self._writer = None
            self._about.begin_file()
            return self._begin(now)
        return self._writer

    def _note_gone(self, writer: RecordingWriter, now: int) -> None:
        """Nobody will find what is written to a file that was deleted or moved."""
        self._gone_at, what = now, "moved"
        if writer.is_deleted:
            what = "deleted"
            self._counts["mcap_lost"] += self._counts["mcap_written"] - self._written_before
        self._gone = f"mcap: {writer.path}: was {what} while it was written; a new file began"

    def _reopen(self, now: int) -> RecordingWriter | None:
        """The next file, with the latched messages; None if it is too early to try."""
        wait = self._retry_at - now  # longer than RETRY_S: the clock was set back since
        return None if 0 < wait <= RETRY_S * 1e9 else self._begin(now)

    def _begin(self, now: int) -> RecordingWriter:
        """The next file; deleted again if there is no room for the latched messages."""
        if self._limits.total_bytes is not None:
            self._counts["mcap_deleted"] += self._files.make_room(self._limits.total_bytes)
            for file in self._files.stuck:
                logger().warning(
                    "mcap_not_deleted", file=file, hint="delete it, or the next files go instead"
                )
        path = self._files.begin(now)
        writer: RecordingWriter | None = None
        try:
            writer = RecordingWriter(path, self._metadata)
            for held in self._latched.values():
                writer.write(held, now)
            writer.flush()
        except Exception as error:
            if writer is not None:
                writer.abandon()
            path.unlink(missing_ok=True)
            if isinstance(error, OSError) and error.filename is None:  # of a write
                error.filename = str(path)
            raise
        self._writer, self._opened_at, self._problem = writer, now, ""
        self._head, self._written_before = writer.size, self._counts["mcap_written"]
        self._is_gone = False
        self._counts["mcap_files"] += 1
        return writer
