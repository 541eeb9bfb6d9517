"""Measures how much of the scan the map explains at claims."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from eigenscan.geometry.pose import from_message
from eigenscan.schemas.channels import HYPOTHESES, POSE
from eigenscan.schemas.envelope import Envelope, nanoseconds
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.evaluation.metrics import errors, right
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LITTLE = 0.75
"""Share of the beams, median over all claims, below which the map is worth a look.

Logs on maps that fit have 0.83 to 0.99, with 30 % of the walls missing 0.68 to 0.72 (intel, fr079).
"""


def explained_at_claims(published: Iterable[Envelope]) -> Floats:
    """Share of a scan's beams that the map explains (k,), for each claim whose pose the scan's list has."""
    lists: dict[int, tuple[Floats, Floats]] = {}
    found = []
    for envelope in published:
        if envelope.channel is HYPOTHESES:
            listed = envelope.open(Hypotheses).hypotheses
            poses = np.asarray([from_message(each.pose) for each in listed]).reshape(-1, 3)
            lists[envelope.stamp] = poses, np.asarray([each.explained for each in listed])
        elif envelope.channel is POSE:
            claim = envelope.open(PoseEstimate)
            listed_there = lists.get(nanoseconds(claim.timestamp))
            if claim.state != STATE_LOCALIZED or listed_there is None:
                continue
            poses, explained = listed_there
            same = np.flatnonzero(
                right(*errors(poses, np.broadcast_to(from_message(claim.pose), poses.shape)))
            )
            if len(same):
                found.append(explained[same[0]])
    return np.asarray(found, dtype=np.float64)
