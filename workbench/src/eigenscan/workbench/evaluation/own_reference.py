"""References for a log that comes without one."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
from eigenscan.geometry.pose import from_pose3
from eigenscan.runtime.recording import RecordingError, read
from eigenscan.schemas.channels import TRUTH
from eigenscan.workbench.evaluation.log import Log
from eigenscan.workbench.evaluation.reference import EvaluationError, Trajectory
from eigenscan.workbench.evaluation.reported import Reported
from eigenscan.workbench.evaluation.workers import Workers
from eigenscan.workbench.logs import open_log
from eigenscan.workbench.logs.recording import RecordingLog
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

Pose = NDArray[np.float64]

RECORDED = "the recording's own truth"
WHOLE_DRIVE = "the drive as a whole"
"""The pipeline's own poses over the whole log. Figures against them are agreement, not accuracy."""


def recorded_truth(path: Path, robot: str) -> Trajectory | None:
    """The true poses that a simulator wrote into a recording; None if there are none."""
    if not isinstance(open_log(path), RecordingLog):
        return None
    truths: dict[str, dict[int, Pose]] = {}
    with suppress(RecordingError):  # the file is cut: its first part counts
        for record in read(path):
            received = record.envelope
            if received.channel == TRUTH:
                poses = truths.setdefault(received.address["robot"], {})
                poses[received.stamp] = from_pose3(received.open(PoseInFrame).pose)
    # one robot alone is judged under any name, as its scans are
    poses = truths.get(robot) or (next(iter(truths.values())) if len(truths) == 1 else {})
    return _trajectory(poses) if poses else None


def whole_drive(path: Path, log: Log, workers: Workers) -> tuple[Trajectory, Reported]:
    """The pipeline's claims when it receives the whole log in one run, and what health reported.

    A wrong claim that a cold start makes too is not found by this. Raises EvaluationError.
    """
    run = next(workers.runs([log.whole]))
    stream = run.stream
    claimed = stream.where(stream.localized)
    if not len(claimed):
        longest = next(iter(run.reported.figures()), "")
        found = f". Health reported: {longest}" if longest else ""
        raise EvaluationError(
            f"{path}: nowhere localized on this map, so nothing to compare with: is it the map of this "
            f"building? Otherwise give --ground-truth{found}"
        )
    return _trajectory(dict(zip(claimed.stamps.tolist(), claimed.poses, strict=True))), run.reported


def _trajectory(poses: dict[int, Pose]) -> Trajectory:
    stamps = sorted(poses)
    return Trajectory(np.asarray(stamps, dtype=np.int64), np.asarray([poses[stamp] for stamp in stamps]))
