"""Reads the scans of a log, for use without a robot."""

from __future__ import annotations

import os
import warnings
from pathlib import Path

import numpy as np
from eigenscan.geometry.pose import from_pose3
from eigenscan.localize.scan import Scan
from eigenscan.schemas.channels import DEFAULT_ROBOT, ODOMETRY, SCAN_RAW
from eigenscan.schemas.extra import needs
from eigenscan.schemas.scan_pb2 import RawScan
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray


def read_log(
    path: str | os.PathLike[str], lidar: str | None = None, robot: str = DEFAULT_ROBOT
) -> list[tuple[Scan, NDArray[np.float64] | None]]:
    """Scans in order of time, each with its odometry (3,), m, m, rad, or None if there is none.

    Reads the formats of `eigenscan import`. `lidar`: topic or name of the one to read; default: all.
    `robot`: the one whose scans to read, in a recording of several. Warns of what it set aside. Raises
    LogError (a ValueError) if the log cannot be read. Needs pip install 'eigenscan-localize[logs]'.
    """
    with needs("eigenscan-localize[logs]"):
        from eigenscan.workbench.logs import LogOptions, open_log
        from eigenscan.workbench.logs.remarks import remarks
        from eigenscan.workbench.logs.scans import odometry_at
    scans, steps = list[Scan](), list[tuple[int, NDArray[np.float64]]]()
    log = open_log(Path(path), LogOptions(robot=robot, lidars=(lidar,) if lidar else ()))
    for envelope in log.envelopes():
        if envelope.channel is ODOMETRY:
            steps.append((envelope.stamp, from_pose3(envelope.open(Odometry).pose)))
        elif envelope.channel is SCAN_RAW:
            scans.append(Scan.of(envelope.open(RawScan), envelope.address["lidar"]))
    for line in remarks(log.counters):
        warnings.warn(f"{path}: {line}", stacklevel=2)
    if log.damage:
        warnings.warn(log.damage, stacklevel=2)
    poses = odometry_at(steps, np.array([scan.stamp for scan in scans], dtype=np.int64))
    return list(zip(scans, poses, strict=True))
