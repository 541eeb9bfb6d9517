"""Locates a log's scans on a map, by the pipeline's own claims."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from eigenscan.mapbuilder.mapping.chain import Sweep
from eigenscan.mapbuilder.mapping.given_map import Located
from eigenscan.schemas.channels import ODOMETRY
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.evaluation.chosen import PipelineSettings
from eigenscan.workbench.evaluation.models import build
from eigenscan.workbench.evaluation.pipeline import Pipeline

SURE = 0.9
"""Confidence of a claim that counts, as for a trusted observer of the mapbuilder."""


def locate(
    map_file: Path,
    received: Sequence[Envelope],
    sweeps: list[Sweep],
    moved: Callable[[str], Callable[[float], None]],
    with_odometry: bool = True,
) -> Located:
    """Where the tracker is sure of the sweeps' poses on a map_server yaml, or on a model folder's map.

    `received`: the log's raw scans and odometry. `moved` starts a progress bar by its title.
    Raises MapError or ModelError.
    """
    settings = PipelineSettings()
    built = build(map_file, settings.mapbuilder, moved("model"))
    stream = Pipeline(built.models, settings).run(_played(received, moved("locating"), with_odometry)).stream
    sure = np.flatnonzero(stream.localized & (stream.confidence >= SURE))
    rows = {int(stream.stamps[row]): int(row) for row in sure}
    numbers = [number for number, sweep in enumerate(sweeps) if sweep.stamp in rows]
    found = [rows[sweeps[number].stamp] for number in numbers]
    return Located(
        built.site.grid,
        np.asarray(numbers, dtype=np.int64),
        stream.poses[found],
        stream.covariances[found],
    )


def _played(
    received: Sequence[Envelope], moved: Callable[[float], None], with_odometry: bool
) -> Iterator[Envelope]:
    for count, envelope in enumerate(received, 1):
        if with_odometry or envelope.channel is not ODOMETRY:
            yield envelope
        moved(count / len(received))
