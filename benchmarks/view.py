"""What `eigenscan view` takes for longer and longer recordings: seconds, peak memory, size of the picture.

    python benchmarks/view.py [--minutes 1 --minutes 10 --minutes 60] [--json OUT]

The conformance vectors' drive, a robot with 5 scans and 50 odometries a second, said again and again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from eigenscan.runtime.recording import RecordingWriter, read
from eigenscan.workbench.conformance.vectors import DRIVE, folder
from eigenscan.workbench.playback.cast import shifted

GAP_NS = 100_000_000
"""Between the end of the drive and its start."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, action="append", help="may be repeated")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    rows = []
    print(f"{'minutes':>8} {'recording MB':>13} {'picture MB':>11} {'drawn in s':>11} {'peak MB':>8}")
    for minutes in given.minutes or [1.0, 10.0, 60.0]:
        with tempfile.TemporaryDirectory() as place:
            row = measure(Path(place), minutes)
        rows.append(row)
        print(
            f"{row['minutes']:8.0f} {row['recording_mb']:13.1f} {row['picture_mb']:11.1f} "
            f"{row['drawn_s']:11.1f} {row['peak_mb']:8.0f}",
            flush=True,
        )
    if given.json:
        given.json.write_text(json.dumps(rows, indent=1) + "\n")


def measure(place: Path, minutes: float) -> dict[str, float]:
    recording, picture = place / "long.mcap", place / "long.rrd"
    repeat(recording, minutes * 60.0)
    command = [sys.executable, "-c", PEAK, "view", str(recording), "--rrd", str(picture), "--no-open"]
    before = time.monotonic()
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    return {
        "minutes": minutes,
        "recording_mb": recording.stat().st_size / 1e6,
        "picture_mb": picture.stat().st_size / 1e6,
        "drawn_s": time.monotonic() - before,
        "peak_mb": int(done.stdout.split()[-1]) * (1024 if sys.platform == "linux" else 1) / 1e6,
    }


PEAK = """
import resource
from eigenscan.cli.main import app
app(standalone_mode=False)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def repeat(target: Path, seconds: float) -> None:
    """Writes the drive over and over until it lasts so long; the models once."""
    drive = list(read(folder() / DRIVE))
    first = drive[0].log_time
    length = drive[-1].log_time - first + GAP_NS
    with RecordingWriter(target) as writer:
        for turn in range(int(seconds * 1e9 / length) + 1):
            for record in drive:
                by = turn * length
                if record.log_time - first + by > seconds * 1e9:
                    return
                if turn and record.envelope.channel.qos.latched:
                    continue
                writer.write(shifted(record.envelope, by), record.log_time + by)


if __name__ == "__main__":
    main()
