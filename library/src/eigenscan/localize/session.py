"""One robot's drive: the cores that know its past."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.geometry.pose import to_pose3
from eigenscan.ingest.core import ScanIngestCore
from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.localize.scan import Scan, ScanError, taken
from eigenscan.projector.core import ProjectorCore
from eigenscan.schemas.channels import DEFAULT_ROBOT, DEFAULT_SITE, MODEL_SET, ODOMETRY, POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.loopback import Loopback
from eigenscan.schemas.methods import of_service
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

if TYPE_CHECKING:
    from eigenscan.tracker.core import TrackerCore

_ROBOT = {"site": DEFAULT_SITE, "robot": DEFAULT_ROBOT}


class Session:
    """Tracks one robot: a scan-ingest and a tracker of its own beside the map's projector."""

    def __init__(self, method: str, site: SiteModel, projector: ProjectorCore) -> None:
        self._ingest, self._projector = ScanIngestCore(ScanIngestSettings()), projector
        projector.forget_robots()
        self._loop = Loopback([projector, _new_tracker(method, site)])
        self._newest: dict[str, int] = {}
        """Stamp of each lidar's latest scan, ns."""

    def track(self, scan: Scan, odometry: NDArray[np.float64] | None) -> PoseEstimate:
        """The pose after one more scan; `odometry` (3,). Raises ScanError."""
        if scan.stamp <= self._newest.get(scan.lidar, scan.stamp - 1):
            fix = "name each of several lidars: Scan(..., lidar=NAME)"
            raise ScanError(f"time = {scan.time}: must be after that of the scan before; {fix}")
        if scan.stamp < max(self._newest.values(), default=scan.stamp):
            raise ScanError(f"time = {scan.time}: must not be before that of another lidar's scan")
        received = taken(self._ingest, scan)
        self._newest[scan.lidar] = scan.stamp
        if odometry is not None:
            message = Odometry(timestamp=stamp(scan.stamp), pose=to_pose3(odometry))
            received.insert(0, Envelope(ODOMETRY, _ROBOT, message))
        published = [each for one in received for each in self._loop.receive(one)]
        published += self._loop.finish()  # nothing else comes that a scan or its hypotheses could wait for
        estimates = [each.open(PoseEstimate) for each in published if each.channel is POSE]
        if not estimates:
            raise ScanError(f"the projector set the scan aside: {self._projector.condition().detail}")
        return estimates[-1]


def _new_tracker(method: str, site: SiteModel) -> TrackerCore:
    """Imports the tracker, which compiles it, only when it is needed. It knows the site's floors."""
    from eigenscan.tracker.core import TrackerCore
    from eigenscan.tracker.settings import TrackerSettings

    settings = TrackerSettings.model_validate(of_service(method, "tracker"))
    tracker = TrackerCore(settings, believes_stamps=True)
    list(tracker.handle(Envelope(MODEL_SET, {"site": DEFAULT_SITE}, site.to_message())))
    return tracker
