"""The picture of the traffic to a live web viewer, a .rrd file, or both."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path

import rerun as rr
from eigenscan.recorder.core import Sink
from eigenscan.recorder.options import RecorderOptions
from eigenscan.recorder.picture.drawing import Picture
from eigenscan.recorder.web_viewer import Viewer, free_port, serve_viewer
from eigenscan.runtime.printable import in_link
from eigenscan.schemas.envelope import Envelope

APPLICATION = "eigenscan"
FLUSH_S, FILE_S = 0.3, 60.0
"""Time to send data to a live viewer at the end, s, whose rest is dropped; and to a file alone, which is
waited for: on a busy machine or a slow disk that takes longer."""
LOOK_S = 5.0
"""Between two looks whether the file is written, s."""
WRITER_ENDED = "File-writer thread shut down"
"""What Rerun's flush reports after a write to the file failed; it tries none again."""


class RerunSink(Sink):
    """Draws every message."""

    def __init__(self, settings: RecorderOptions) -> None:
        """Opens files and ports. Raises SettingsError or OSError that names the unavailable one."""
        self._counts: Counter[str] = Counter(drawn=0)
        self._closing = ExitStack()
        self._stream = rr.RecordingStream(APPLICATION)
        self._viewer: Viewer | None = None
        self._rrd, self._looked_at, self._ended = settings.rrd, time.monotonic(), ""
        sinks: list[rr.FileSink | rr.GrpcServerSink] = []
        if settings.rrd is not None:
            settings.rrd.parent.mkdir(parents=True, exist_ok=True)
            settings.rrd.open("wb").close()  # Rerun itself only logs that it cannot write
            sinks.append(rr.FileSink(str(settings.rrd)))
        if settings.viewer_port is not None:
            sinks.append(self._serve(settings, settings.viewer_port))
        self._stream.set_sinks(*sinks)
        self._picture = Picture(
            self._stream,
            settings.picture_hz,
            settings.layout,
            settings.plot_window_s,
            live=settings.viewer_port is not None,
            draw_all=settings.draw_all,
        )

    @property
    def url(self) -> str:
        """The page to open; empty without a live viewer."""
        return self._viewer.link if self._viewer else ""

    @property
    def problem(self) -> str:
        """That the file is not written any more, or the live viewer's server has ended."""
        return self._ended or (self._viewer.problem if self._viewer else "")

    @property
    def counters(self) -> Mapping[str, int]:
        """`drawn`."""
        return self._counts

    def write(self, received: Envelope) -> None:
        """Draws the message, if it has a picture."""
        self._picture.draw(received)
        self._counts["drawn"] += 1
        if self._rrd is not None and time.monotonic() - self._looked_at > LOOK_S:
            self._look(self._rrd)

    def flush(self) -> None:
        """Hands over all that was drawn."""
        self._picture.flush()
        if not self.url:
            self._stream.flush(timeout_sec=FILE_S)
            return
        with suppress(RuntimeError):  # what a slow viewer misses harms nobody
            self._stream.flush(timeout_sec=FLUSH_S)

    def close(self) -> None:
        """Completes the file and stops serving."""
        self.flush()
        self._stream.disconnect()
        self._closing.close()

    def _look(self, rrd: Path) -> None:
        self._looked_at = time.monotonic()
        try:
            self._stream.flush(timeout_sec=FLUSH_S)
        except RuntimeError as error:  # of a slow disk, too
            if WRITER_ENDED in str(error):
                self._ended = f"rrd: {rrd}: a write failed, and it ends there: free space, then start again"

    def _serve(self, settings: RecorderOptions, page_port: int) -> rr.GrpcServerSink:
        host = settings.viewer_host
        data = free_port("data_port", host, settings.data_port)
        page = free_port("viewer_port", host, page_port)
        self._viewer = self._closing.enter_context(serve_viewer(host, page, data))
        return rr.GrpcServerSink(
            in_link(host),
            data,
            server_memory_limit=settings.viewer_memory,
            cors_allow_origin=[settings.viewer_origin] if settings.viewer_origin else None,
        )
