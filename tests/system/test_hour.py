"""A scripted hour, compressed: a site and two robots, a machine each, to which all sorts of things happen."""

import os
from typing import Any

import pytest

from tests.machines.hour import CLOCK_S, hour, play

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(os.geteuid() != 0, reason="network namespaces need root"),
]

ROBOTS = ("r1", "r2")
CUT_S, FULL_S, PAUSE_S = 15.0, 5.0, 1.0
UNLOCALIZED_S = 3.0
"""At most, of robots from which nothing was taken; by the stamps of their scans."""
BACK_S = 30.0
"""At most, beyond the time until what was taken states that it works. Zenoh tries again after up to 4 s."""
LATE_S = 20.0
"""Of what is judged by the time of arrival, on a busy machine."""
UNDELIVERED = 0.05
"""Share of the poses that may be lost though there is a way: those that two processes time differently,
of which one has them too soon after another for the air."""
MISSED = 20
"""Poses in a row, of 4 s: by the contract a link may lose some, more on a busy machine; it is not silent.

10 were missing in one run beside two benchmarks, and never again. The cause is not known: the simulated
network drops only what its faults drop, so it cannot show it.
"""


@pytest.fixture(scope="module")
def passed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the hour cost."""
    with hour(tmp_path_factory.mktemp("hour"), ROBOTS, 1800.0, PAUSE_S, hold_back_floods=False) as made:
        return play(made, CUT_S, FULL_S, 1, print)


def test_no_robot_claims_a_wrong_place(passed: dict[str, Any]) -> None:
    assert passed["claims"] > 400
    assert passed["wrong"] == dict.fromkeys(ROBOTS, 0)


def test_everything_happened(passed: dict[str, Any]) -> None:
    names = [event["name"] for event in passed["events"]]
    assert len(names) == 4 + 4 + 3 + 3 + 4, names


def test_no_robot_is_unlocalized_for_long(passed: dict[str, Any]) -> None:
    for event in passed["events"]:
        for robot, seconds in event["beyond_s"].items():
            assert seconds < (BACK_S if robot in event["touches"] else UNLOCALIZED_S), (robot, event)


def test_what_the_site_receives_is_recorded_but_while_its_recorder_or_router_is_gone(
    passed: dict[str, Any],
) -> None:
    assert passed["heard_at_site"] > 100
    assert passed["unrecorded"] == 0


def test_what_a_robot_publishes_is_received_at_the_site_while_there_is_a_way(passed: dict[str, Any]) -> None:
    """That it is received again after each event, the script waits for."""
    assert passed["said"] > 100
    assert passed["longest_undelivered"] < MISSED
    assert passed["undelivered"] < UNDELIVERED * passed["said"]


def test_a_full_disk_is_reported_and_what_is_written_stays(passed: dict[str, Any]) -> None:
    disk = passed["disk"]
    assert "No space left" in disk["detail"]
    assert "messages are lost" in disk["detail"]
    assert disk["counters"]["mcap_lost"] > 0
    assert len(disk["files"]) == 3  # before the recorder's restart, until the disk was full, after it
    assert min(disk["files"].values()) > 0


def test_a_bad_link_delays_what_the_site_receives_and_nothing_else(passed: dict[str, Any]) -> None:
    air = passed["bad_air"]
    assert air["said"] > 15
    assert air["arrived"] > 1.0 - UNDELIVERED  # TCP brings again what the link loses, and all of it counts
    assert air["longest_silence_s"] < LATE_S
    assert air["median_ms"] > air["delay_ms"] * 0.9
    assert max(air["unlocalized_s"].values()) < UNLOCALIZED_S


def test_who_was_cut_off_gets_the_models_that_were_made_meanwhile(passed: dict[str, Any]) -> None:
    assert passed["new_models_s"].keys() == set(ROBOTS)
    assert min(passed["new_models_s"].values()) > 0.0


def test_the_site_shows_how_old_its_view_is_and_whose_clock_is_off(passed: dict[str, Any]) -> None:
    behind, right = passed["status"]["whole"]
    assert (behind["robot"], right["robot"]) == ROBOTS
    assert abs(behind["clock_offset_s"] - CLOCK_S) < LATE_S
    assert abs(right["clock_offset_s"]) < LATE_S
    for row in (behind, right):
        assert row["state"] == "localized"
        assert row["pose_age_s"] < LATE_S
    for row in passed["status"]["cut"]:
        assert CUT_S / 2 < row["pose_age_s"] < passed["status"]["cut_s"] + LATE_S
