"""The pace of a playback."""

import time

from eigenscan.schemas.channels import POSE
from eigenscan.schemas.envelope import Envelope, stamp
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.workbench.playback.controls import NoControls
from eigenscan.workbench.playback.player import Player, Score
from eigenscan.workbench.simulation.stage import Timed

NOW = 1_700_000_000_000_000_000


def pose(at: int) -> Timed:
    return Timed(at, Envelope(POSE, {"site": "s", "robot": "r"}, PoseEstimate(timestamp=stamp(at))))


def test_years_between_two_messages_are_not_waited_for() -> None:
    """A recorder's clock begins in 1970 until it is set; and two nights lie in one folder."""
    times = [1_000_000_000, 1_050_000_000, NOW, NOW + 50_000_000]
    published: list[Envelope] = []
    score = Score(lambda _: map(pose, times), times[0], times[0], times[-1])
    began = time.monotonic()
    Player(score, published.append, NoControls(), lambda *_: None, clock=time.time_ns).play()
    assert 0.05 < time.monotonic() - began < 5.0
    stamps = [one.stamp for one in published]
    assert stamps == sorted(stamps)
    assert abs(stamps[-1] - time.time_ns()) < 5e9  # shifted to the present, on both sides
