"""What goes wrong on a site: services that end, come late or receive nonsense."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import zenoh
from eigenscan.schemas.channels import HYPOTHESES, MODEL_SET, ODOMETRY, POSE, SCAN, SCAN_RAW, Channel
from eigenscan.schemas.envelope import Envelope, nanoseconds, stamp
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.schemas.wire import encode, encoding

from tests.system.house import Drive, House, reference

pytestmark = pytest.mark.slow

ORDER = ("recorder", "mapbuilder", "projector", "tracker", "scan-ingest")


def start_all(house: House, models: Path) -> None:
    house.start("recorder", "--mcap", house.logs / "site.mcap")
    house.start("mapbuilder", "--model", models)
    for service in ("projector", "tracker", "scan-ingest"):
        house.start(service)
    house.until("projector", ready, "has models")


def ready(health: Health) -> bool:
    return health.status == Health.STATUS_OK


def send(house: House, channel: Channel, message: object, **address: str) -> None:
    """One message from a stranger on a key of the site."""
    envelope = Envelope(channel, {"site": house.site, "robot": "robot", **address}, message)  # type: ignore[arg-type]
    house.session.put(envelope.key, encode(envelope.message), encoding=zenoh.Encoding(encoding(channel)))


def scans_of(drive: Drive, count: int) -> list[RawScan]:
    return [e.open(RawScan) for e in drive.envelopes if e.channel is SCAN_RAW][:count]


@pytest.mark.dataset
def test_every_service_ends_in_good_order_when_asked_to(drive: Drive, models: Path, house: House) -> None:
    start_all(house, models)
    for scan in scans_of(drive, 5):
        send(house, SCAN_RAW, scan, lidar="front")
    house.ear.wait_for(lambda received: any(e.channel is HYPOTHESES for e in received), "hypotheses")
    for service in ORDER:
        assert house.terminate(service) == 0, f"{service}\n{house.log(service)}"
        assert "unfinished=False" in house.log(service) or '"unfinished": false' in house.log(service)


@pytest.mark.dataset
def test_a_projector_that_starts_without_the_site_has_the_models_it_received(
    drive: Drive, models: Path, house: House
) -> None:
    house.start("mapbuilder", "--model", models)
    house.start("projector", "--keep", house.logs / "kept")
    house.until("projector", ready, "has models")
    for service in ("projector", "mapbuilder"):
        house.kill(service)
    house.start("projector", "--keep", house.logs / "kept")
    house.until("projector", lambda health: health.detail.startswith("model "), "has models from the disk")
    for service in ("tracker", "scan-ingest"):
        house.start(service)
    claims = drive_on(house, iter(scans_of(drive, 10)))
    assert claims
    assert not wrong(claims)


@pytest.mark.dataset
def test_a_second_mapbuilder_stands_in_for_the_first(models: Path, house: House) -> None:
    for instance in ("first", "standby"):
        house.start("mapbuilder", "--model", models, "--instance", instance, alias=instance)
    house.kill("first")
    house.start("projector")
    (version,) = {message.version for message in house.ear.of(MODEL_SET, ModelSet)}
    house.until("projector", lambda health: health.detail == f"model {version[:12]}", "has models")


def drive_on(house: House, scans: Iterator[RawScan]) -> list[PoseEstimate]:
    """Publishes ten more scans; gives the claims but for the last pose, which may wait for another scan."""
    some = [next(scans) for _ in range(10)]
    for scan in some:
        send(house, SCAN_RAW, scan, lidar="front")
    first, last = nanoseconds(some[0].timestamp), nanoseconds(some[7].timestamp)
    house.ear.wait_for(lambda _: last_pose(house) >= last, "poses")
    poses = [pose for pose in house.ear.of(POSE, PoseEstimate) if nanoseconds(pose.timestamp) >= first]
    return [pose for pose in poses if pose.state == STATE_LOCALIZED]


def wrong(claims: list[PoseEstimate]) -> list[PoseEstimate]:
    """Those more than half a metre from the log's reference."""
    true = reference(np.array([nanoseconds(claim.timestamp) for claim in claims]))
    away = np.hypot(*(np.array([[claim.pose.x, claim.pose.y] for claim in claims]) - true).T)
    return [claim for claim, metres in zip(claims, away, strict=True) if metres > 0.5]


def last_pose(house: House) -> int:
    published = house.ear.of(POSE, PoseEstimate)
    return max((nanoseconds(pose.timestamp) for pose in published), default=0)


@pytest.mark.dataset
def test_nonsense_is_counted_and_harms_nobody(drive: Drive, models: Path, house: House) -> None:
    start_all(house, models)
    true_scan = scans_of(drive, 1)[0]
    keys = {
        SCAN_RAW: f"{house.site}/robot/robot/scan/raw/front",
        SCAN: f"{house.site}/robot/robot/scan/front",
        HYPOTHESES: f"{house.site}/robot/robot/hypotheses/front/0",
        ODOMETRY: f"{house.site}/robot/robot/odom",
    }
    for channel, key in keys.items():
        # bytes that are no message, another version of the contract, another schema
        house.session.put(key, b"\xff\xff\xff\x01nonsense", encoding=zenoh.Encoding(encoding(channel)))
        newer = encoding(channel).rpartition("/")[0] + "/99"
        house.session.put(key, encode(true_scan), encoding=zenoh.Encoding(newer))
        other = zenoh.Encoding("application/protobuf;eigenscan.Nothing/1")
        house.session.put(key, encode(true_scan), encoding=other)
    house.session.put(f"{house.site}/robot/robot/nobody/knows", b"x")
    house.session.put(f"{house.site}/robot/robot/scan/raw/a/b/c", b"x")
    for service in ("scan-ingest", "projector", "tracker"):
        house.until(
            service, lambda health: health.counters["undecodable"] >= 3, "counts what does not decode"
        )
    house.until("recorder", lambda health: health.counters["dropped_foreign_key"] >= 2, "counts foreign keys")

    start = nanoseconds(true_scan.timestamp)
    for number, ranges in enumerate(([], [np.nan] * 180, [np.inf] * 180, [0.0] * 180, [-1.0] * 180)):
        empty = RawScan()
        empty.CopyFrom(true_scan)
        empty.timestamp.CopyFrom(stamp(start + number * 100_000_000))
        empty.ranges[:] = ranges
        send(house, SCAN_RAW, empty, lidar="front")
        send(house, SCAN, as_canonical(empty), lidar="other")
    refused = ("set_aside_no_beams", "set_aside_no_valid_range")
    house.until(
        "scan-ingest", lambda health: all(health.counters[name] for name in refused), "sets scans aside"
    )
    house.until("projector", lambda health: health.counters["heard_scan"] >= 5, "hears the empty scans")

    sound = [scan for scan in scans_of(drive, 20) if nanoseconds(scan.timestamp) > start + 500_000_000]
    last = nanoseconds(sound[0].timestamp)
    for scan in sound:
        send(house, SCAN_RAW, scan, lidar="front")
    house.ear.wait_for(lambda _: last_pose(house) >= last, "a pose after all that")
    for service in ORDER:
        assert house.running[service].poll() is None, f"{service} ended\n{house.log(service)}"
    blind = [pose for pose in house.ear.of(POSE, PoseEstimate) if nanoseconds(pose.timestamp) < last]
    assert all(pose.state != STATE_LOCALIZED for pose in blind)
    assert all(
        np.isfinite([pose.pose.x, pose.pose.y, pose.pose.theta, pose.confidence]).all() for pose in blind
    )


def as_canonical(raw: RawScan) -> Scan:
    return Scan(
        timestamp=raw.timestamp,
        frame_id="base_link",
        mount=raw.mount,
        angle_min=raw.angle_min,
        angle_increment=raw.angle_increment,
        ranges=raw.ranges,
    )
