"""SE(2) on plain floats: geometry.pose for one pose at a time, at a twentieth of numpy's cost.

Odometry comes far more often than scans, one pose a message.
"""

from __future__ import annotations

from math import cos, pi, sin

Pose = tuple[float, float, float]
"""x [m], y [m], theta [rad]"""

IDENTITY: Pose = (0.0, 0.0, 0.0)


def wrap(angle: float) -> float:
    """Same direction in [-pi, pi)."""
    wrapped = (angle + pi) % (2.0 * pi) - pi
    return wrapped if wrapped < pi else -pi


def compose(a: Pose, b: Pose) -> Pose:
    """Pose `b`, given in the frame of `a`, in the frame that `a` is given in."""
    c, s = cos(a[2]), sin(a[2])
    return a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], wrap(a[2] + b[2])


def inverse(a: Pose) -> Pose:
    """Pose that composes with `a` to the identity."""
    c, s = cos(a[2]), sin(a[2])
    return -c * a[0] - s * a[1], s * a[0] - c * a[1], wrap(-a[2])


def between(a: Pose, b: Pose) -> Pose:
    """Pose `b` seen from `a`."""
    c, s = cos(a[2]), sin(a[2])
    dx, dy = b[0] - a[0], b[1] - a[1]
    return c * dx + s * dy, c * dy - s * dx, wrap(b[2] - a[2])


def scaled(a: Pose, share: float) -> Pose:
    """A share, 0..1, of an increment."""
    return share * a[0], share * a[1], share * a[2]
