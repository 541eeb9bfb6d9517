"""Converts candidates and obstacles to messages: base poses in the map frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from eigenscan.geometry.message_floats import put_floats
from eigenscan.geometry.pose import covariance_to_message, to_message
from eigenscan.projector.candidates import Candidates, Fitted
from eigenscan.projector.columns import Record, doubles, flag, floats, messages, nested, record
from eigenscan.projector.coordinates import coordinates
from eigenscan.projector.focus import Scope
from eigenscan.projector.local import REACH_M
from eigenscan.projector.observation import Observation
from eigenscan.projector.obstacles import ObstacleMask, find_obstacles
from eigenscan.projector.reconstruction import occluded
from eigenscan.projector.site import Site
from eigenscan.schemas.geometry_pb2 import Covariance3, Pose2
from eigenscan.schemas.hypotheses_pb2 import (
    SEARCH_LOCAL,
    SEARCH_WHOLE,
    Hypotheses,
    Hypothesis,
    Obstacles,
    Projection,
)
from eigenscan.schemas.scan_pb2 import Scan
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

REPORTED = 64
"""Projections of a message at most: it must not grow with the site."""
AROUND_M2 = float(np.pi * REACH_M**2)
"""Area of a search around one pose."""
_UPPER = np.array([0, 1, 2, 4, 5, 8])
"""Of a covariance row by row: what is on or above its diagonal."""


@dataclass(frozen=True)
class _Blanks:
    """Records of the messages that a scan gets many of."""

    projection: Record
    hypothesis: Record


@cache
def _blanks(components: int) -> _Blanks:
    of, reported = Hypothesis, Projection
    C = Covariance3
    upper = C.XX_FIELD_NUMBER, C.XY_FIELD_NUMBER, C.XT_FIELD_NUMBER, C.YY_FIELD_NUMBER, C.YT_FIELD_NUMBER
    return _Blanks(
        record(
            coefficients=floats(reported.COEFFICIENTS_FIELD_NUMBER, components),
            error_energy=doubles(reported.ERROR_ENERGY_FIELD_NUMBER),
            searched=flag(reported.SEARCHED_FIELD_NUMBER),
        ),
        record(
            pose=nested(
                of.POSE_FIELD_NUMBER, Pose2.X_FIELD_NUMBER, Pose2.Y_FIELD_NUMBER, Pose2.THETA_FIELD_NUMBER
            ),
            covariance=nested(of.COVARIANCE_FIELD_NUMBER, *upper, C.TT_FIELD_NUMBER),
            log_likelihood=doubles(of.LOG_LIKELIHOOD_FIELD_NUMBER),
            error_energy=doubles(of.ERROR_ENERGY_FIELD_NUMBER),
            explained=doubles(of.EXPLAINED_FIELD_NUMBER),
            coefficients=floats(of.COEFFICIENTS_FIELD_NUMBER, components),
        ),
    )


def unusable(scan: Scan, site: Site, seen: Observation) -> Hypotheses:
    """The answer to a scan with too few beams."""
    return _answer(scan, site, seen, status=Hypotheses.STATUS_UNUSABLE_SCAN)


def _answer(scan: Scan, site: Site, seen: Observation, **fields: Any) -> Hypotheses:
    """What each answer to a scan states, and the `fields` of this one."""
    return Hypotheses(
        timestamp=scan.timestamp,
        frame_id=site.frame_id,
        model_version=site.version,
        used_beams=seen.returned,
        inexactness=site.inexactness,
        gathered=scan.gathered,
        motion=scan.motion if scan.HasField("motion") else None,
        **fields,
    )


def hypotheses_message(
    scan: Scan, site: Site, seen: Observation, mount: Array, found: Candidates, scope: Scope
) -> Hypotheses:
    """The hypotheses found in `scope`, most likely first."""
    base, covariances = to_base(found.poses, found.covariances, mount)
    energy = found.projected.error_energy
    reported = reported_regions(found)
    message = _answer(
        scan,
        site,
        seen,
        status=Hypotheses.STATUS_OK,
        unlisted_log_likelihood=found.unlisted_log_likelihood,
        searched_area_m2=site.area(_searched(scope, found)),
        search=SEARCH_WHOLE,
        surfaces=found.surfaces,
        cut=found.cut,
    )
    projected, alike = found.projected, _blanks(found.projected.coefficients.shape[1])
    message.MergeFromString(
        messages(
            Hypotheses.PROJECTIONS_FIELD_NUMBER,
            alike.projection,
            (Projection.REGION_FIELD_NUMBER, [site.regions[r] for r in reported.tolist()]),
            {
                "coefficients": projected.coefficients[reported],
                "error_energy": energy[reported, None],
                "searched": projected.searched[reported],
            },
        )
        + messages(
            Hypotheses.HYPOTHESES_FIELD_NUMBER,
            alike.hypothesis,
            (Hypothesis.REGION_FIELD_NUMBER, [site.regions[r] for r in found.region.tolist()]),
            {
                "pose": base,
                "covariance": covariances.reshape(-1, 9)[:, _UPPER],
                "log_likelihood": found.log_likelihoods[:, None],
                "error_energy": energy[found.region, None],
                "explained": found.explained[:, None],
                "coefficients": coordinates(
                    site.view(seen.sensor), site.lattice, found.poses, found.region, seen.sensor.angle_min
                ),
            },
        )
    )
    return message


def local_message(scan: Scan, site: Site, seen: Observation, mount: Array, found: Fitted) -> Hypotheses:
    """The one pose that the scan was fitted to; of others nothing is known."""
    (base,), (covariance,) = to_base(found.pose[None], found.covariance[None], mount)
    position = site.lattice.nearest(found.pose[None, :2])[0]
    message = _answer(
        scan, site, seen, status=Hypotheses.STATUS_OK, searched_area_m2=AROUND_M2, search=SEARCH_LOCAL
    )
    message.hypotheses.add(
        pose=to_message(base),
        covariance=covariance_to_message(covariance),
        log_likelihood=found.log_likelihood,
        region=site.regions[site.lattice.region_of[position]],
        explained=found.explained,
    )
    return message


def _searched(scope: Scope, found: Candidates) -> NDArray[np.bool_] | None:
    """Regions (R,) that the answer is about; None: all."""
    return scope.regions if found.waiting is None else scope.among(~found.waiting)


def reported_regions(found: Candidates) -> NDArray[np.int64]:
    """Regions (r,) whose projections are published: on large sites the candidates' and the best ones."""
    energy = found.projected.error_energy
    projected = np.flatnonzero(np.isfinite(energy))
    if len(projected) <= REPORTED:
        return projected
    best = np.argpartition(energy, REPORTED)[:REPORTED]
    return np.union1d(best[np.argsort(energy[best])][: max(REPORTED - len(found.poses), 0)], found.region)


def obstacles_message(
    scan: Scan, site: Site, seen: Observation, mount: Array, pose: Array, found: Candidates | None = None
) -> Obstacles:
    """Obstacles at a sensor pose (3,), of the search's results; `mount` (3,): the lidar in the base frame."""
    mask = _mask(site, seen, pose, found)
    message = Obstacles(
        timestamp=scan.timestamp,
        frame_id=site.frame_id,
        pose=to_message(to_base(pose[None], np.zeros((1, 3, 3)), mount)[0][0]),
        mask=mask.mask.tobytes(),
        error_energy=mask.error_energy,
        confidence=mask.confidence,
        sensor_x=mask.in_sensor[:, 0].tolist(),
        sensor_y=mask.in_sensor[:, 1].tolist(),
        map_x=mask.in_map[:, 0].tolist(),
        map_y=mask.in_map[:, 1].tolist(),
        model_version=site.version,
    )
    put_floats(message, Obstacles.ERROR_FIELD_NUMBER, mask.error)
    return message


def _mask(site: Site, seen: Observation, pose: Array, found: Candidates | None) -> ObstacleMask:
    sensor = seen.sensor
    bearings: Array = sensor.angle_min + np.arange(sensor.beams, dtype=np.float64) * sensor.angle_increment
    view = site.view(sensor)
    if view.foreseen_by == "reconstruction" and found is not None:
        return occluded(view, seen, found, pose, bearings)
    limit = sensor.range_max if sensor.range_max > 0 else 100.0
    predicted = site.caster.cast(pose, bearings, limit)[0]
    return find_obstacles(pose, bearings, seen.ranges, predicted, site.drawn, site.caster.grid)


def to_base(poses: Array, covariances: Array, mount: Array) -> tuple[Array, Array]:
    """Base poses (n, 3) and covariances (n, 3, 3) of sensor poses on a robot with `mount` (3,)."""
    base, turned = np.empty(poses.shape), np.empty(covariances.shape)
    _to_base(poses, covariances, mount, base, turned)
    return base, turned


@njit(cache=True, nogil=True)  # pragma: no cover - compiled
def _to_base(poses: Array, covariances: Array, mount: Array, base: Array, turned: Array) -> None:
    # the base in the sensor's frame
    cos, sin, turn = np.cos(mount[2]), np.sin(mount[2]), -mount[2]
    x, y = -cos * mount[0] - sin * mount[1], sin * mount[0] - cos * mount[1]
    for i in range(len(poses)):
        cos, sin = np.cos(poses[i, 2]), np.sin(poses[i, 2])
        # the base swings about the sensor: d base / d theta is perpendicular to the arm between them
        ahead, aside = cos * x - sin * y, sin * x + cos * y
        base[i, 0], base[i, 1] = poses[i, 0] + ahead, poses[i, 1] + aside
        heading = (poses[i, 2] + turn + np.pi) % (2.0 * np.pi) - np.pi
        # modulo of a tiny negative number rounds to a full turn
        base[i, 2] = heading if heading < np.pi else -np.pi
        swing = (-aside, ahead, 0.0)
        # J C J', where J is the identity and the swing in its last column
        c = covariances[i]
        for row in range(3):
            for column in range(3):
                turned[i, row, column] = (
                    c[row, column]
                    + swing[row] * c[2, column]
                    + swing[column] * c[row, 2]
                    + swing[row] * swing[column] * c[2, 2]
                )
