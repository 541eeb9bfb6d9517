"""Finds out whether a reference is in another frame than the map: one transform then mends all errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from eigenscan.geometry.circle import wrap
from eigenscan.geometry.pose import compose, transform
from eigenscan.workbench.evaluation.metrics import Judged, errors, right

FEW, NEARLY_ALL = 0.5, 0.9
"""Shares of the claims that are right as the reference is, at most, and in another frame, at least."""
LEAST_WINDOWS = 3
"""A wrong place is off by one transform, too; three windows seldom have the same one."""


def other_frame(judged: Sequence[Judged]) -> dict[str, float] | None:
    """Pose, m and degrees, of the reference's frame in the map that makes nearly all claims right.

    None where many are right as it is, or where no one pose does.
    """
    claims = [(j.stream.poses[held], j.offsets[held]) for j in judged if (held := j.stream.localized).any()]
    if len(claims) < LEAST_WINDOWS:
        return None
    poses, offsets = (np.concatenate(each) for each in zip(*claims, strict=True))
    truth = poses - offsets
    if np.mean(right(*errors(poses, truth))) > FEW:
        return None
    middle = np.angle(np.mean(np.exp(1j * offsets[:, 2])))
    turn = float(wrap(middle + np.median(wrap(offsets[:, 2] - middle))))
    x, y = np.median(poses[:, :2] - transform([0.0, 0.0, turn], truth[:, :2]), axis=0).tolist()
    share = float(np.mean(right(*errors(poses, compose([x, y, turn], truth)))))
    if share < NEARLY_ALL:
        return None
    return {"x_m": x, "y_m": y, "heading_deg": float(np.degrees(turn)), "right_share": share}
