"""The recorder as a process."""

from __future__ import annotations

import time

from eigenscan.recorder.core import RecorderCore, Sink
from eigenscan.schemas.extra import needs

with needs("eigenscan-recorder[node]", SystemExit):
    import zenoh
    from eigenscan.recorder.background_sink import BackgroundSink
    from eigenscan.recorder.files import Files
    from eigenscan.recorder.mcap_sink import McapSink
    from eigenscan.recorder.options import RecorderOptions
    from eigenscan.recorder.uploads import Uploads
    from eigenscan.runtime.clock import Clock
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run
    from eigenscan.runtime.settings import SettingsError
    from eigenscan.schemas.group import is_one

NAME = "recorder"
SEEN_BATCH_S, BATCH_S = 0.05, 0.2
"""Longest that messages wait to be handled in a row, s: where someone watches, and where not. The longer one
takes a sixth off the recorder's CPU time (benchmarks/light.py). Log times are those of the arrival."""
BATCH_SHARE = 0.4
"""Of `flush_s`, at most: a crash also loses what waits."""
_UPLOADS: list[Uploads] = []
"""Held for as long as the process is."""


def batch_s(settings: RecorderOptions) -> float:
    """How long messages may wait, s."""
    watched = settings.viewer_port is not None or settings.foxglove_port is not None
    return min(SEEN_BATCH_S if watched else BATCH_S, BATCH_SHARE * settings.flush_s)


def make_core(settings: RecorderOptions, clock: Clock = time) -> RecorderCore:
    """The core with the sinks that the settings ask for, the recording first."""
    sinks: list[Sink] = []
    if settings.mcap is not None:
        metadata = {NAME: {"settings": settings.model_dump_json()}}
        sinks.append(
            McapSink(
                settings.mcap,
                settings.site,
                clock.time_ns,
                settings.flush_s - batch_s(settings),
                metadata,
                settings.limits,
                clock.perf_counter,
            )
        )
    if settings.rrd is not None or settings.viewer_port is not None:
        from eigenscan.recorder.rerun_sink import RerunSink

        picture = RerunSink(settings)
        if picture.url:
            print(f"viewer: {picture.url}", flush=True)
        sinks.append(BackgroundSink(picture))
    if settings.foxglove_port is not None:
        with needs("eigenscan-recorder[foxglove]", SettingsError):
            from eigenscan.recorder.foxglove_sink import FoxgloveSink
        served = FoxgloveSink(settings.viewer_host, settings.foxglove_port, settings.site)
        print(f"foxglove: {served.url}", flush=True)
        sinks.append(BackgroundSink(served))
    if not sinks:
        raise SettingsError("nothing to record to: give mcap, rrd, viewer_port or foxglove_port")
    return RecorderCore(sinks)


def _offer_uploads(settings: RecorderOptions, session: zenoh.Session) -> None:
    """Lets the site fetch the files of a robot's recorder."""
    if settings.mcap is not None and settings.uploads and is_one(settings.robot):
        _UPLOADS.append(Uploads(Files(settings.mcap, settings.site)))
        _UPLOADS[-1].offer(session, settings.site, settings.robot)


SERVICE = Service(NAME, RecorderOptions, make_core, whole_site=True, attend=_offer_uploads, batch_s=batch_s)


def main() -> None:
    """Entry point."""
    run(SERVICE)


if __name__ == "__main__":
    main()
