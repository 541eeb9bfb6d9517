"""All that was said of all windows, as a table for one's own plots and comparisons."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from eigenscan.workbench.evaluation.metrics import Stream

COLUMNS = ("window", "time_ns", "x", "y", "theta", "state", "confidence")


def write_poses(path: Path, streams: Sequence[Stream]) -> None:
    """Writes a row for each pose; m, rad, numbers exact to the last bit; `window` counts from 0."""
    with path.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for number, said in enumerate(streams):
            rows = zip(said.stamps, said.poses, said.states, said.confidence, strict=True)
            for stamp, pose, state, confidence in rows:
                table.writerow(
                    [number, int(stamp), *map(repr, pose.tolist()), int(state), repr(float(confidence))]
                )
