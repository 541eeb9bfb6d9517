"""When messages of others are missing: a recorder that stood still, or whose router is gone."""

import pytest
from eigenscan.runtime.health import Monitor
from eigenscan.runtime.interruptions import LEASE_S, SHOWN_S, Interruptions
from eigenscan.schemas.envelope import Condition
from eigenscan.schemas.health_pb2 import Health


def _look(seen: Interruptions, *links: str, seconds: int = 1) -> None:
    """Once a second, at routers (R…) and peers."""
    for _ in range(seconds):
        seen.look([one for one in links if one[0] == "R"], [one for one in links if one[0] != "R"], 1.0)


@pytest.mark.parametrize("link", ["R1", "peer"])
def test_a_process_that_stood_still_reports_it_for_a_while(link: str) -> None:
    """Zenoh drops its links after LEASE_S, and what waits in its socket: 30 s were missing, health OK."""
    seen = Interruptions()
    _look(seen, link, seconds=5)
    assert not seen.problem
    seen.look([link] if link == "R1" else [], [] if link == "R1" else [link], 30.0)
    assert (seen.count, seen.seconds) == (1, 30.0)
    assert "30 s are missing" in seen.problem
    _look(seen, link, seconds=int(SHOWN_S))
    assert not seen.problem


def test_a_pause_that_links_survive_costs_nothing() -> None:
    seen = Interruptions()
    _look(seen, "R1")
    seen.look(["R1"], [], LEASE_S - 1)
    assert not seen.problem


def test_without_the_router_messages_are_missing_until_it_is_there_again() -> None:
    seen = Interruptions()
    _look(seen, "R1", seconds=3)
    _look(seen, seconds=20)
    assert "no link to the router" in seen.problem
    _look(seen, "R2")
    assert (seen.count, seen.seconds) == (1, 21.0)
    assert "21 s are missing" in seen.problem


def test_a_router_that_was_restarted_between_two_looks_is_another_one() -> None:
    seen = Interruptions()
    _look(seen, "R1")
    _look(seen, "R2")
    assert seen.count == 1


def test_who_comes_and_goes_is_not_missed() -> None:
    seen = Interruptions()
    for _ in range(3):
        _look(seen, "doctor")
        _look(seen)
    _look(seen, "R1", "peer")
    _look(seen, "peer")  # a robot without its site
    _look(seen, "R2", "peer")
    assert (seen.count, seen.problem) == (0, "")
    seen = Interruptions()
    _look(seen, seconds=3)  # the site's router is not there yet
    seen.look([], [], 30.0)
    assert (seen.count, seen.problem) == (0, "")


def test_a_service_that_misses_messages_is_degraded() -> None:
    monitor = Monitor("recorder", "0", "1")
    monitor.turn(Condition(Health.STATUS_OK, "", {}))
    monitor.missing = "messages are missing"
    condition = monitor.condition()
    assert condition.status == Health.STATUS_DEGRADED
    assert "missing" in condition.detail
