"""The recorder as a process."""

from __future__ import annotations

import time

from eigenscan.recorder.core import RecorderCore, Sink
from eigenscan.schemas.extra import needs

with needs("eigenscan-recorder[node]", SystemExit):
    from eigenscan.recorder.aside import Aside
    from eigenscan.recorder.mcap_sink import McapSink
    from eigenscan.recorder.options import RecorderOptions
    from eigenscan.runtime.node import main as run_node
    from eigenscan.runtime.settings import SettingsError

SERVICE = "recorder"


def make_core(settings: RecorderOptions) -> RecorderCore:
    """The core with the sinks that the settings ask for, the recording first."""
    sinks: list[Sink] = []
    if settings.mcap is not None:
        metadata = {SERVICE: {"settings": settings.model_dump_json()}}
        sinks.append(
            McapSink(settings.mcap, settings.site, time.time_ns, settings.flush_s, metadata, settings.limits)
        )
    if settings.rrd is not None or settings.viewer_port is not None:
        from eigenscan.recorder.rerun_sink import RerunSink

        picture = RerunSink(settings)
        if picture.url:
            print(f"viewer: {picture.url}", flush=True)
        sinks.append(Aside(picture))
    if not sinks:
        raise SettingsError("nothing to record to: give mcap, rrd or viewer_port")
    return RecorderCore(sinks)


def main() -> None:
    """Entry point."""
    run_node(SERVICE, RecorderOptions, make_core, whole_site=True)


if __name__ == "__main__":
    main()
