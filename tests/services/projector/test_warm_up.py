"""What is compiled before the first scan is what a scan needs."""

import subprocess
import sys

import numpy as np
from eigenscan.geometry.pose import to_message
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up
from eigenscan.schemas.channels import ADVICE, SEARCH, TRACKS
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SearchRequest
from eigenscan.schemas.tracking_pb2 import STATE_AMBIGUOUS, Track, Tracks

from tests.services.projector.office import ADDRESS, free_poses, ready, receive, scan_at


def test_the_three_scans_are_answered() -> None:
    # hypotheses and obstacles of each, and the advice
    assert warm_up(ProjectorSettings()) == 7
    assert warm_up(ProjectorSettings(advice=False)) == 6


def test_a_real_scan_compiles_nothing_more() -> None:
    # in a process of its own: other tests have compiled much
    ran = subprocess.run([sys.executable, "-m", __name__], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr


def _compiled() -> dict[str, int]:
    """Signatures of each compiled function of the projector."""
    return {
        f"{module}.{name}": len(value.signatures)
        for module, content in list(sys.modules.items())
        if module.startswith("eigenscan.projector.")
        for name, value in vars(content).items()
        if hasattr(value, "signatures")
    }


def _check() -> None:
    from tests.services.projector.office import site

    built = site(0.25)
    warm_up(ProjectorSettings())
    before = _compiled()
    core = ready(built)
    for i, truth in enumerate(free_poses(4, 1)):
        lidar, at = f"of {90 * (i + 1)} degrees", 10**15 + i
        scans = [
            scan_at(truth, field_of_view=np.deg2rad(90.0 * (i + 1)), seed=i, time=time)
            for time in (at, at + 100_000_000)
        ]
        receive(core, scans[0], lidar=lidar)
        request = SearchRequest(timestamp=stamp(at), frame_id="map", search=SEARCH_LOCAL)
        request.pose.CopyFrom(to_message(truth))
        request.covariance.xx = request.covariance.yy = request.covariance.tt = 0.001
        request.least_log_likelihood = -1e6
        list(core.handle(Envelope(SEARCH, {**ADDRESS, "lidar": lidar}, request)))
        assert receive(core, scans[1], lidar=lidar)[0].search == SEARCH_LOCAL
    at = 10**15 + 3 + 100_000_000
    places = [Track(id=i, pose=to_message(pose), probability=0.5) for i, pose in enumerate(free_poses(2, 7))]
    tracks = Tracks(timestamp=stamp(at), frame_id="map", tracks=places, state=STATE_AMBIGUOUS)
    (advice,) = core.handle(Envelope(TRACKS, ADDRESS, tracks))
    assert advice.channel is ADVICE
    more = sorted(name for name, count in _compiled().items() if count > before.get(name, 0))
    assert before
    assert not more, f"compiled at a scan: {', '.join(more)}"


if __name__ == "__main__":
    _check()
