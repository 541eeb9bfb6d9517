"""Joins parts of a log without a connection, if enough of their walls agree.

A single hallway looks like another. So each submap of a part is compared with all others, anywhere and at any
heading. Each match votes for a pose of the whole part, and only votes of several submaps that agree, and
outnumber all others by far, join it.
"""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import Array, compose, inverse
from eigenscan.mapbuilder.mapping.closures import RIGID, Closer
from eigenscan.mapbuilder.mapping.correlation import apart
from eigenscan.mapbuilder.mapping.pose_graph import Edge

ASKED = 12
"""Submaps of a part that vote."""
VOTERS = 2
"""Submaps, with one between them, that must agree."""
OUTVOTE = 2.0
"""Times that the votes must exceed those for any other pose."""
STRICT = 1.6
"""Times the overlap of a loop closure that a match needs."""
ANYWHERE = np.array([np.inf, np.pi])
_SAME = 1.0, float(np.deg2rad(15.0))


def bridge(closer: Closer) -> None:
    """Joins parts to the largest one where possible; the others stay apart."""
    while True:
        numbers, counts = np.unique(closer.part, return_counts=True)
        main, *others = numbers[np.argsort(-counts, kind="stable")].tolist()
        if not any(_joined(closer, other, main) for other in others):
            return


def _joined(closer: Closer, part: int, main: int) -> bool:
    """Whether `part` could be joined to `main`, and now is."""
    parts = np.array(closer.part)
    own, rest = np.nonzero(parts == part)[0], np.nonzero(parts == main)[0]
    asked = own[np.unique(np.linspace(0, len(own) - 1, min(len(own), ASKED)).astype(int))]
    votes = [
        (Edge(int(one), int(other), match.pose, RIGID), match.net)
        for other in asked
        for one in rest
        if (match := closer.match(int(one), int(other), np.zeros(3), ANYWHERE, STRICT)) is not None
    ]
    if not votes:
        return False
    frames = np.array([_frame(closer, edge) for edge, _ in votes])
    nets = np.array([net for _, net in votes])
    same = np.array([~apart(frames, frame, *_SAME) for frame in frames])
    best = int(np.argmax(same @ nets))
    chosen = same[best]
    voters = [edge.second for (edge, _), mine in zip(votes, chosen, strict=True) if mine]
    rivals = (same[~chosen] & ~chosen) @ nets
    if max(voters) - min(voters) < VOTERS or (same @ nets)[best] < OUTVOTE * rivals.max(initial=0.0):
        return False
    moved = parts == part
    closer.poses[moved] = compose(frames[best], closer.poses[moved])
    closer.part = np.where(moved, main, parts).tolist()
    closer.edges += [edge for (edge, _), mine in zip(votes, chosen, strict=True) if mine]
    closer.solve()
    return True


def _frame(closer: Closer, vote: Edge) -> Array:
    """The frame of the second submap's part in the first one's, by one match."""
    return compose(compose(closer.poses[vote.first], vote.pose), inverse(closer.poses[vote.second]))
