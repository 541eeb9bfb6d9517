"""What `doctor` states of a robot, by what its services publish."""

from __future__ import annotations

import time
from collections import deque

import pytest
from eigenscan.fleet.diagnosis import diagnose
from eigenscan.fleet.view import FleetView, Robot, Service
from eigenscan.runtime.inbox import Arrival
from eigenscan.schemas.channels import CONTRACT_VERSION, HEALTH, MODEL_SET
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.model_pb2 import ModelSet
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.wire import encode, encoding


def site(**details: str) -> FleetView:
    """A robot r17 whose services wait, each with its detail."""
    view = FleetView.__new__(FleetView)
    view.site, view.robots, view.services, view.model_versions = "s", {}, {}, deque(maxlen=2)
    view.listed, view.expected = frozenset(), frozenset({"r17"})
    for service, detail in details.items():
        name = service.replace("_", "-")
        health = Health(service=name, instance="r17", status=Health.STATUS_WAITING, detail=detail)
        key = HEALTH.key({"site": "s", "service": name, "instance": "r17"})
        view._receive(Arrival(HEALTH, key, encode(health), encoding(HEALTH)), 0.0, 0)
    for each in view.services.values():
        each.contracts.add(str(CONTRACT_VERSION))
    return view


@pytest.mark.parametrize(
    ("services", "what", "mend"),
    [
        ({}, "no scans arrive", "let the lidar's driver publish on s/robot/r17/scan/raw/LIDAR"),
        ({"ros_bridge": "no scan yet on /scan"}, "no scan yet on /scan", "rmw_zenohd"),
    ],
)
def test_missing_scans_are_looked_for_where_they_come_from(
    services: dict[str, str], what: str, mend: str
) -> None:
    view = site(scan_ingest="no scan", **services)
    (found,) = [each for each in diagnose(view) if "no scans arrive" in each.what]
    assert what in found.what
    assert mend in found.mend


def test_a_robot_of_which_nothing_is_there_is_one_fault() -> None:
    view = site(scan_ingest="no scan")
    view.expected = frozenset({"r17", "r18"})
    (found,) = [each for each in diagnose(view) if each.where == "robot r18"]
    assert "nothing of it is there: it or its link is off" in found.what
    assert "doctor --site s --zenoh" in found.mend


def test_a_robot_that_gets_models_does_not_miss_the_mapbuilder_that_it_cannot_see() -> None:
    """On a robot the doctor advised to start a mapbuilder, while the site's was at work."""
    view = site(router="routing", tracker="no scan")
    (found,) = [each for each in diagnose(view) if each.where == "site s"]
    assert "certificate may be revoked" in found.what
    assert "at the site: eigenscan doctor --site s" in found.mend
    view.model_versions.append("a")
    assert not [each for each in diagnose(view) if each.where == "site s"]


def test_a_site_without_mapbuilder_needs_one() -> None:
    view = site(tracker="no scan")
    view.services["router", "site"] = Service("router", "site", {str(CONTRACT_VERSION)})
    (found,) = [each for each in diagnose(view) if each.where == "site s"]
    assert "no mapbuilder" in found.what
    assert "eigenscan-mapbuilder --site s" in found.mend


def test_a_revoked_robot_that_is_still_received_is_a_fault() -> None:
    """Before the site's router has the new configuration, it was shown as any other."""
    view = site(scan_ingest="no scan")
    assert not view.is_stranger("r17")
    view.listed = view.expected = frozenset({"r18"})
    fixes = [each.mend for each in diagnose(view) if "revoked" in each.what and each.where == "robot r17"]
    assert len(fixes) == 1
    assert "site/router.json5" in fixes[0]


@pytest.mark.parametrize(("version", "old"), [("b" * 64, True), ("a" * 64, False), ("", False)])
def test_a_robot_on_older_models_is_a_fault_and_one_that_states_none_is_not(version: str, old: bool) -> None:
    view = site(scan_ingest="no scan", projector="", tracker="")
    view.model_versions.append("a" * 64)
    view.robots["r17"] = Robot("r17", pose=PoseEstimate(model_version=version))
    for service in view.services.values():
        service.first = Health()
        assert service.health is not None
        service.health.counters["heard_scan_raw"] = 5
    assert any("uses model" in each.what for each in diagnose(view)) is old


def test_two_machines_under_one_name_are_a_fault_and_a_restart_is_none() -> None:
    """One robot's certificate on two machines was one healthy robot whose position jumped."""
    view = site(tracker="no scan")
    (tracker,) = view.services.values()
    first, second = (Health(counters={"heard_scan": count, "waiting": 1000 - count}) for count in (900, 100))
    now = time.monotonic()
    for n, health in enumerate((first, second)):
        tracker.receive(health, now + n)
    assert not tracker.is_twice
    for n, health in enumerate((first, second)):
        tracker.receive(health, now + 2 + n)
    assert tracker.is_twice
    assert any("two machines publish under this name" in each.what for each in diagnose(view))


def test_what_a_service_counts_grows_from_0_after_a_restart() -> None:
    """Lost messages were "-899 so far"."""
    view = site(tracker="no scan")
    (tracker,) = view.services.values()
    for n, count in enumerate((900, 1, 3)):
        tracker.receive(Health(counters={"undecodable": count}), time.monotonic() + n)
    assert tracker.grew("undecodable") == 3


def test_a_map_that_gets_smaller_is_no_second_machine() -> None:
    """A mapbuilder that learned twice in a few seconds was two machines."""
    view = site(mapbuilder="no map")
    (mapbuilder,) = view.services.values()
    now = time.monotonic()
    for n, positions in enumerate((900, 800, 700)):
        mapbuilder.receive(Health(counters={"taken_scan": n, "positions": positions}), now + n)
    assert not mapbuilder.is_twice


@pytest.mark.parametrize(
    ("versions", "found"), [(("a", "a"), False), (("a", "b"), True), (("a", "b", "b"), False)]
)
def test_two_mapbuilders_of_different_maps_are_a_fault(versions: tuple[str, ...], found: bool) -> None:
    view = site(mapbuilder="no map")
    second = Service("mapbuilder", "m2", {str(CONTRACT_VERSION)})
    view.services["mapbuilder", "m2"] = second
    for version in versions:
        key = MODEL_SET.key({"site": "s"})
        payload = encode(ModelSet(version=version))
        view._receive(Arrival(MODEL_SET, key, payload, encoding(MODEL_SET)), 0.0, 0)
    words = "mapbuilders m2 and r17 publish different models"
    assert (words in [each.what for each in diagnose(view)]) == found


def test_one_mapbuilder_may_publish_new_models() -> None:
    view = site(mapbuilder="no map")
    view.model_versions.extend("ab")
    assert not any("different models" in each.what for each in diagnose(view))


def test_a_site_without_any_robot_is_not_well() -> None:
    view = site(mapbuilder="no map")
    view.expected = frozenset()
    assert "no robot is there" in [each.what for each in diagnose(view)]
