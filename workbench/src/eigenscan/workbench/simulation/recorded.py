"""A short drive of a real robot through a real building, with a kidnap: the Intel Research Lab in Seattle.

Recorded by Dirk Hähnel, CC-BY-3.0. `tools/real_drive.py` cuts it from the log. Map and truth: a SLAM run.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from eigenscan.geometry.gridmap import GridMap, read_map
from eigenscan.geometry.pose import Array, from_pose3
from eigenscan.runtime.recording import read
from eigenscan.schemas.channels import TRUTH
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.playback.cast import shifted
from eigenscan.workbench.simulation.stage import Scenario, Timed
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from numpy.typing import NDArray

INTEL = Path(__file__).parent / "intel"
CARRIED_M = 3.0
"""Nobody drives this far from one scan to the next."""


class Recorded:
    """A recording with the truth at each scan, in place of a `Stage`.

    `epoch`, ns: stamp of the first message.
    """

    def __init__(self, folder: Path, site: str) -> None:
        self.grid: GridMap = read_map(folder / "map.yaml")
        self._envelopes = [
            Envelope(
                record.envelope.channel, {**record.envelope.address, "site": site}, record.envelope.message
            )
            for record in read(folder / "drive.mcap")
        ]
        self._first = self.epoch = self._envelopes[0].stamp
        truths = [each for each in self._envelopes if each.channel == TRUTH]
        self._stamps = np.array([each.stamp for each in truths], dtype=np.int64)
        self.poses: Array = np.array([from_pose3(each.open(PoseInFrame).pose) for each in truths])
        far = np.hypot(*np.diff(self.poses[:, :2], axis=0).T) > CARRIED_M
        self.jumps: NDArray[np.int64] = 1 + np.flatnonzero(far)
        seconds = float(self._stamps[-1] - self._first) * 1e-9
        self.scenario = Scenario(seconds=seconds, site=site, robot=truths[0].address["robot"], people=0)

    @property
    def times(self) -> NDArray[np.int64]:
        """Stamps (n,) of the poses, ns."""
        return self._stamps + (self.epoch - self._first)

    @property
    def scan_ticks(self) -> NDArray[np.int64]:
        """Indices (n,) of the poses at which scans were taken: all."""
        return np.arange(len(self._stamps))

    @property
    def kidnap_time(self) -> int | None:
        """Stamp of the first pose after the kidnap, ns."""
        return int(self.times[self.jumps[0]]) if len(self.jumps) else None

    @property
    def keys(self) -> list[str]:
        """Every key that messages are published on."""
        return sorted({each.key for each in self._envelopes})

    def pose_at(self, time: int) -> Array:
        """True pose (3,) at the scan nearest to the stamp `time`, ns."""
        pose: Array = self.poses[int(np.argmin(np.abs(self.times - time)))]
        return pose

    def messages(self) -> Iterator[Timed]:
        """Odometry, raw scans and the truth at each scan, in order of time."""
        for envelope in self._envelopes:
            later = shifted(envelope, self.epoch - self._first)
            yield Timed(later.stamp, later)
