"""Candidates and obstacles as the contract says them: base poses in the map frame."""

from __future__ import annotations

import numpy as np
from eigenscan.geometry.pose import compose, covariance_to_message, inverse, to_message
from eigenscan.projector.observation import Observation
from eigenscan.projector.obstacles import find_obstacles
from eigenscan.projector.projection import Candidates
from eigenscan.projector.site import Site
from eigenscan.schemas.hypotheses_pb2 import Hypotheses, Hypothesis, Obstacles, Projection
from eigenscan.schemas.scan_pb2 import Scan
from numpy.typing import NDArray

Array = NDArray[np.float64]


def unusable(scan: Scan, site: Site, seen: Observation) -> Hypotheses:
    """The answer to a scan with too few beams."""
    return Hypotheses(
        timestamp=scan.timestamp,
        frame_id=site.frame_id,
        status=Hypotheses.STATUS_UNUSABLE_SCAN,
        model_version=site.version,
        used_beams=int(np.count_nonzero(seen.used)),
    )


def hypotheses_message(
    scan: Scan, site: Site, seen: Observation, mount: Array, found: Candidates
) -> Hypotheses:
    """The list, most likely first."""
    base, covariance = to_base(found.poses, found.covariances, mount)
    listed = [
        Hypothesis(
            pose=to_message(base[i]),
            covariance=covariance_to_message(covariance[i]),
            log_likelihood=float(found.log_likelihoods[i]),
            region=site.regions[found.region[i]],
            error_energy=float(found.projected.error_energy[found.region[i]]),
            explained=float(found.explained[i]),
        )
        for i in range(len(base))
    ]
    return Hypotheses(
        timestamp=scan.timestamp,
        frame_id=site.frame_id,
        status=Hypotheses.STATUS_OK,
        hypotheses=listed,
        unlisted_log_likelihood=found.unlisted_log_likelihood,
        searched_area_m2=site.free_area_m2,
        model_version=site.version,
        used_beams=int(np.count_nonzero(seen.used)),
        projections=[
            Projection(
                region=region,
                coefficients=coefficients.tolist(),
                error_energy=float(energy),
                searched=True,
            )
            for region, coefficients, energy in zip(
                site.regions, found.projected.coefficients, found.projected.error_energy, strict=True
            )
        ],
    )


def obstacles_message(
    scan: Scan, site: Site, seen: Observation, mount: Array, found: Candidates
) -> Obstacles:
    """What the most likely pose does not explain."""
    pose = found.poses[0]
    sensor = seen.sensor
    bearings: Array = sensor.angle_min + np.arange(sensor.beams, dtype=np.float64) * sensor.angle_increment
    limit = sensor.range_max if sensor.range_max > 0 else 100.0
    predicted = site.caster.cast(pose, bearings, limit)[0]
    mask = find_obstacles(pose, bearings, seen.ranges, predicted)
    return Obstacles(
        timestamp=scan.timestamp,
        frame_id=site.frame_id,
        pose=to_message(compose(pose, inverse(mount))),
        mask=mask.mask.tobytes(),
        error=mask.error.tolist(),
        error_energy=mask.error_energy,
        confidence=mask.confidence,
        sensor_x=mask.in_sensor[:, 0].tolist(),
        sensor_y=mask.in_sensor[:, 1].tolist(),
        map_x=mask.in_map[:, 0].tolist(),
        map_y=mask.in_map[:, 1].tolist(),
        model_version=site.version,
    )


def to_base(poses: Array, covariances: Array, mount: Array) -> tuple[Array, Array]:
    """Base poses (n, 3) and covariances (n, 3, 3) of sensor poses on a robot with `mount` (3,)."""
    base = compose(poses, inverse(mount))
    J = np.tile(np.eye(3), (len(poses), 1, 1))
    # the base swings about the sensor: d base / d theta is perpendicular to the arm between them
    J[:, 0, 2] = -(base[:, 1] - poses[:, 1])
    J[:, 1, 2] = base[:, 0] - poses[:, 0]
    return base, J @ covariances @ J.transpose(0, 2, 1)
