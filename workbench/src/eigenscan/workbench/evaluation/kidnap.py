"""Kidnap: halfway through a window the log jumps to another window's start.

Stamps continue without a gap and odometry without a step, so the robot does not notice it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from eigenscan.geometry.pose import between, compose, from_pose3, to_pose3
from eigenscan.schemas.channels import ODOMETRY, SCAN_RAW
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.scan_pb2 import RawScan
from eigenscan.workbench.evaluation.metrics import Judged, Stream, judge, seconds, sustained
from eigenscan.workbench.evaluation.reference import Trajectory
from eigenscan.workbench.evaluation.windows import Window
from eigenscan.workbench.playback.cast import shifted
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from numpy.typing import NDArray

NOISE = 1e-6
"""Of a range, by which scans after the jump differ from what they were: some bits of a float32."""
AWAY_M = 3.0
"""A jump shorter than this is no kidnap."""


@dataclass(frozen=True)
class Plan:
    """Where a kidnapped window ends and where it continues."""

    before: Window
    after: Window


def plan(windows: Sequence[Window], reference: Trajectory) -> list[Plan]:
    """For each window another one, half the list later, that starts far from the middle of the first."""
    plans = []
    for index, window in enumerate(windows):
        half = Window(window.start, (window.start + window.end) // 2)
        others = [windows[(index + len(windows) // 2 + k) % len(windows)] for k in range(len(windows))]
        starts, known = reference.at([other.start for other in others])
        here, _ = reference.at([half.end])
        far = known & (np.hypot(*(starts - here)[:, :2].T) >= AWAY_M)
        if far.any():
            plans.append(Plan(half, others[int(np.argmax(far))]))
    return plans


@dataclass(frozen=True)
class Splice:
    """A log with a jump: messages in order, the jump's stamp, and the shift of later stamps, ns."""

    received: list[Envelope]
    jump: int
    moved: int


def splice(before: Sequence[Envelope], after: Sequence[Envelope]) -> Splice:
    """Joins two stretches of a log, both with scans, one scan period apart."""
    scans = _stamps(after)
    period = int(np.median(np.diff(scans))) if len(scans) > 1 else 100_000_000
    # nothing of the later stretch may come before the end of the earlier one
    jump = max(e.stamp for e in before) + max(period, 1)
    moved = jump - min(e.stamp for e in after)
    step = _odometry_step(before, after)
    return Splice([*before, *(_moved(envelope, moved, step) for envelope in after)], jump, moved)


def _stamps(envelopes: Sequence[Envelope]) -> list[int]:
    return sorted(envelope.stamp for envelope in envelopes if envelope.channel == SCAN_RAW)


def _odometry_step(before: Sequence[Envelope], after: Sequence[Envelope]) -> NDArray[np.float64]:
    """Transform (3,) that takes the later stretch's odometry frame to the earlier one's."""
    ends = [e.open(Odometry).pose for e in before if e.channel == ODOMETRY][-1:]
    starts = [e.open(Odometry).pose for e in after if e.channel == ODOMETRY][:1]
    if not ends or not starts:
        return np.zeros(3)
    start = from_pose3(starts[0])
    return compose(from_pose3(ends[0]), between(start, np.zeros(3)))


def _moved(envelope: Envelope, by: int, step: NDArray[np.float64]) -> Envelope:
    moved = shifted(envelope, by)
    if moved.channel == SCAN_RAW:  # windows overlap, and no lidar measures the same to the last bit again
        ranges = moved.open(RawScan).ranges
        ranges[:] = [each * (1.0 + NOISE) for each in ranges]
    if moved.channel == ODOMETRY:
        pose = moved.open(Odometry).pose
        pose.CopyFrom(to_pose3(compose(step, from_pose3(pose))))
    return moved


@dataclass(frozen=True)
class Outcome:
    """Result of one kidnap; times in s from the jump, None if it did not happen.

    From `recovered_s` on, every pose is claimed and right; `first_right_s` is the first such pose.
    `noticed_s` is None unless the old place was rightly claimed at the jump. `decided`: whether the scans of
    the next 3 s decide where the robot is (`oracle`); None: not looked at.
    """

    claimed_before: bool
    noticed_s: float | None
    recovered_s: float | None
    first_right_s: float | None
    false_after_s: float
    decided: bool | None = None


def outcome(stream: Stream, spliced: Splice, reference: Trajectory) -> Outcome:
    """Judges the poses on both sides of the jump."""
    early = judge(stream.where(stream.stamps < spliced.jump), reference)
    late = stream.where(stream.stamps >= spliced.jump)
    after = judge(_back(late, spliced.moved), reference)
    since = seconds(after.stream.stamps, spliced.jump - spliced.moved)
    claimed = bool(len(early.stream) and early.right_claims[-1])
    noticed = np.flatnonzero(~after.false_claims)
    found = sustained(after.right_claims)
    right = np.flatnonzero(after.right_claims)
    return Outcome(
        claimed_before=claimed,
        noticed_s=float(since[noticed[0]]) if claimed and len(noticed) else None,
        recovered_s=None if found is None else float(since[found]),
        first_right_s=float(since[right[0]]) if len(right) else None,
        false_after_s=_time_false(after, since),
    )


def _back(stream: Stream, moved: int) -> Stream:
    values = {**vars(stream), "stamps": stream.stamps - moved}
    return Stream(**values)


def _time_false(after: Judged, since: NDArray[np.float64]) -> float:
    """Seconds during which a wrong place was claimed."""
    if len(since) < 2:
        return 0.0
    return float(np.diff(since)[after.false_claims[:-1]].sum())
