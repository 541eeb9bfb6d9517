"""Compares a candidate's numbers with the reference, within the limits for another method."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

import numpy as np
from eigenscan.eigenspace.model import ModelError, RegionModel, set_version
from eigenscan.geometry.gridmap import MapError, from_message
from eigenscan.geometry.raycast import RayCaster
from eigenscan.schemas.channels import HYPOTHESES, MAP, MODEL, MODEL_SET, POSE, SCAN, TRUTH, Channel
from eigenscan.schemas.envelope import nanoseconds
from eigenscan.schemas.geometry_pb2 import Pose2
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.model_pb2 import RegionModel as RegionModelMessage
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.conformance.receiving import Received
from eigenscan.workbench.conformance.vectors import Vectors
from eigenscan.workbench.replay.fields import differences
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame

NEAR_M, NEAR_RAD = 0.15, math.radians(3.0)
"""Limits between two good methods on one scan: the map's cells are 0.05 m, a beam's step 1 degree."""
PROJECTED_SHARE = 0.9
"""Share of the scans on which the reference is sure, that a projector must find."""
TRACKED_SHARE = 0.95
"""Share of the reference's claims that a tracker must claim, too."""
SURE = math.log(10.0)
"""Odds of the best hypothesis against the next elsewhere from which the reference is sure."""
RAY_M, RAY_SHARE = 0.11, 0.95
"""Two cells; and the share of a panorama's beams that must hold them, for corners and cracks do not."""
CHECKED_POSITIONS = 200
AREA_SHARE = 0.25
"""Largest relative difference of the free area, because each builder decides what a robot fits into."""

_NOT_COMPARED = {"frame_id", "sequence", "motion"}
"""A name that is a setting, what is counted apart, and what another program may compute in another way."""

Verdict = tuple[list[str], str]
M = TypeVar("M")


def scan_numbers(received: Sequence[Received], vectors: Vectors) -> Verdict:
    """Canonical scans, field by field, but for those of _NOT_COMPARED; and their count."""
    published = {(one.key, one.stamp): one.message for one in received if one.channel is SCAN}
    faults, compared = list(_miscounted(received)), 0
    reference = [one for one in vectors.reference if one.channel is SCAN]
    for expected in reference:
        want = expected.open(Scan)
        got = published.get((expected.key, nanoseconds(want.timestamp)))
        if not isinstance(got, Scan):
            continue
        compared += 1
        for one in differences(want, got, tolerant=True):
            if one.path.partition(".")[0] not in _NOT_COMPARED:
                lidar = expected.address["lidar"]
                faults.append(
                    f"lidar {lidar}: {one.path} is {one.replayed}, the reference has {one.recorded}"
                )
                break
    return faults, f"{compared} scans of {len({e.key for e in reference})} lidars as the reference"


def _miscounted(received: Sequence[Received]) -> Iterator[str]:
    """Places where `sequence` does not count the scans of a lidar from 0."""
    counts: Counter[str] = Counter()
    for one in received:
        if isinstance(one.message, Scan):
            if one.message.sequence != counts[one.key]:
                yield f"{one.key}: scan number {counts[one.key]} has sequence {one.message.sequence}"
                return
            counts[one.key] += 1


def projection_numbers(received: Sequence[Received], vectors: Vectors) -> Verdict:
    """The best hypothesis of each scan that the reference is sure of."""
    published = {one.stamp: one.message for one in received if one.channel is HYPOTHESES}
    truth = _truth(vectors)
    faults, missed, compared = [], [], 0
    for expected in vectors.reference:
        if expected.channel is not HYPOTHESES or not _is_sure(expected.open(Hypotheses)):
            continue
        want = expected.open(Hypotheses)
        stamp = nanoseconds(want.timestamp)
        got = published.get(stamp)
        if not isinstance(got, Hypotheses):
            continue
        compared += 1
        best = got.hypotheses[0] if got.hypotheses else None
        if best is None:
            missed.append(
                f"{_at(stamp)}: the list is empty, the reference has {_pose(want.hypotheses[0].pose)}"
            )
        elif not (_near(best.pose, want.hypotheses[0].pose) or _near(best.pose, truth[stamp])):
            missed.append(
                f"{_at(stamp)}: the best is {_pose(best.pose)}, "
                f"the reference has {_pose(want.hypotheses[0].pose)}"
            )
        elif best.log_likelihood <= max(got.unlisted_log_likelihood, 0.0):
            missed.append(f"{_at(stamp)}: the right pose is called no likelier than one that the map lacks")
    if len(missed) > (1.0 - PROJECTED_SHARE) * compared:
        faults = [f"{len(missed)} of {compared} scans are not found; {missed[0]}"]
    return faults, f"{compared - len(missed)} of {compared} scans found where the reference has them"


def pose_numbers(received: Sequence[Received], vectors: Vectors) -> Verdict:
    """The poses that are claimed, and that they are claimed."""
    published = {one.stamp: one.message for one in received if one.channel is POSE}
    truth = _truth(vectors)
    faults, claimed, compared = [], 0, 0
    for expected in vectors.reference:
        if expected.channel is not POSE:
            continue
        want = expected.open(PoseEstimate)
        stamp = nanoseconds(want.timestamp)
        got = published.get(stamp)
        if not isinstance(got, PoseEstimate):
            continue
        is_claimed = got.state == STATE_LOCALIZED
        if is_claimed and not (_near(got.pose, want.pose) or _near(got.pose, truth[stamp])):
            faults.append(f"{_at(stamp)}: claims {_pose(got.pose)}, the reference has {_pose(want.pose)}")
        if want.state == STATE_LOCALIZED:
            compared += 1
            claimed += is_claimed
    if claimed < TRACKED_SHARE * compared:
        faults.append(
            f"{compared - claimed} of {compared} poses are not claimed as LOCALIZED, as the reference does"
        )
    return faults, f"{claimed} of {compared} poses claimed, all where the reference has them"


def model_numbers(received: Sequence[Received], vectors: Vectors) -> Verdict:
    """Versions by content, the map as given, panoramas as rays through the map give them."""
    grids = _messages(received, MAP, Grid)
    sets = _messages(received, MODEL_SET, ModelSet)
    models = {m.version: m for m in _messages(received, MODEL, RegionModelMessage)}
    if not (grids and sets and models):
        return ["a map, models and a set are needed to compare"], ""
    try:
        grid, announced = from_message(grids[-1]), sets[-1]
    except MapError as error:
        return [str(error)], ""
    want_map, want_set = (
        next(e.message for e in vectors.reference if e.channel is channel) for channel in (MAP, MODEL_SET)
    )
    assert isinstance(want_map, Grid)
    assert isinstance(want_set, ModelSet)
    faults = []
    if grid.version != from_message(want_map).version:
        faults.append("the map is not the one that was given")
    if announced.map_version != grid.version:
        faults.append(
            f"the set is of map {announced.map_version[:12]!r}, the published map is {grid.version[:12]!r}"
        )
    if announced.version != set_version(announced.map_version, [e.version for e in announced.entries]):
        faults.append("the set's version is not the SHA-256 of its parts")
    if not math.isclose(announced.free_area_m2, want_set.free_area_m2, rel_tol=AREA_SHARE):
        faults.append(
            f"free area {announced.free_area_m2:.0f} m^2, the reference has {want_set.free_area_m2:.0f}"
        )
    missing = [entry.region for entry in announced.entries if entry.version not in models]
    if missing:
        faults.append(f"the set names region {missing[0]!r} in a version that was not published")
    caster, positions = RayCaster.of(grid), 0
    for message in models.values():
        try:
            model = RegionModel.from_message(message)
        except ModelError as error:
            faults.append(str(error))
            continue
        positions += len(model.index)
        share = _share_seen(model, caster)
        if share < RAY_SHARE:
            faults.append(
                f"region {model.region!r}: {share:.0%} of its ranges are what the map shows from there"
            )
    return faults, f"{len(models)} regions with {positions} positions, as rays through the map"


def _share_seen(model: RegionModel, caster: RayCaster) -> float:
    """Share of the ranges of some of the positions that are those of rays through the map."""
    chosen = slice(None, None, max(1, len(model.index) // CHECKED_POSITIONS))
    have = model.panoramas[chosen]
    farthest = float(have.max(initial=0.0, where=np.isfinite(have)))
    want = caster.panoramas(model.positions[chosen], have.shape[1], farthest + 1.0)
    with np.errstate(invalid="ignore"):
        same = (np.abs(have - want) <= RAY_M) | (np.isinf(have) & np.isinf(want))
    return float(same.mean())


def _messages(received: Iterable[Received], channel: Channel, kind: type[M]) -> list[M]:
    return [one.message for one in received if one.channel is channel and isinstance(one.message, kind)]


def _truth(vectors: Vectors) -> dict[int, Pose2]:
    found = {}
    for envelope in vectors.reference:
        if envelope.channel is TRUTH:
            message = envelope.open(PoseInFrame)
            turn = message.pose.orientation
            theta = 2.0 * math.atan2(turn.z, turn.w)
            place = message.pose.position
            found[nanoseconds(message.timestamp)] = Pose2(x=place.x, y=place.y, theta=theta)
    return found


def _is_sure(message: Hypotheses) -> bool:
    """Whether no other place comes near the likelihood of the first."""
    first, *others = message.hypotheses
    rivals = [h.log_likelihood for h in others if not _near(h.pose, first.pose)]
    return first.log_likelihood - max(rivals, default=0.0) >= SURE


def _near(a: Pose2, b: Pose2) -> bool:
    return (
        math.hypot(a.x - b.x, a.y - b.y) <= NEAR_M
        and abs(math.remainder(a.theta - b.theta, math.tau)) <= NEAR_RAD
    )


def _pose(pose: Pose2) -> str:
    return f"({pose.x:.2f} m, {pose.y:.2f} m, {math.degrees(pose.theta):.1f} deg)"


def _at(stamp: int) -> str:
    return f"scan of {stamp / 1e9:.3f}"
