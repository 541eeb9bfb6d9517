"""Found means: the claims are right, from some scan on to the end."""

import math
import socket
from dataclasses import replace

import numpy as np
import psutil
import pytest
from eigenscan.cli.demonstration.show import data_port, is_watched, summarize
from eigenscan.workbench.simulation.verdict import Sighting, judge


def _seen(time: float, off_m: float = 0.0, claimed: bool = True, turn: float = 0.0) -> Sighting:
    truth = np.array([3.0, 4.0, math.pi - 0.01])
    heading = (truth[2] + turn + math.pi) % math.tau - math.pi
    pose = np.array([truth[0] + off_m * 0.6, truth[1] - off_m * 0.8, heading])
    return Sighting(time, pose, truth, claimed, 0.9)


def _stretch(*parts: tuple[int, float, bool]) -> list[Sighting]:
    """(count, error in m, claimed), at 10 Hz."""
    rows = [(off, claimed) for count, off, claimed in parts for _ in range(count)]
    return [_seen(0.1 * index, off, claimed) for index, (off, claimed) in enumerate(rows)]


def test_errors_are_distances_and_turns_on_the_circle() -> None:
    seen = _seen(0.0, off_m=0.45, turn=0.1)
    assert seen.error_m == pytest.approx(0.45)
    assert seen.error_rad == pytest.approx(0.1)
    assert seen.right
    assert not _seen(0.0, off_m=0.51).right
    assert not _seen(0.0, turn=0.18).right
    assert not _seen(0.0, turn=-0.18).right


def test_found_after_being_lost() -> None:
    stretch = judge(_stretch((7, 9.0, False), (23, 0.1, True)), 0.0, 3.0)
    assert stretch.found
    assert stretch.found_after == pytest.approx(0.7)
    assert stretch.scans == 8
    assert stretch.noticed_after == 0.0
    assert stretch.error_m == pytest.approx(0.1)
    assert (stretch.claims, stretch.wrong_claims) == (23, 0)


def test_a_wrong_claim_starts_the_count_again() -> None:
    stretch = judge(_stretch((10, 0.1, True), (1, 4.0, True), (10, 0.1, True)), 0.0, 2.1)
    assert stretch.found_after == pytest.approx(1.1)
    assert stretch.wrong_claims == 1


def test_wrong_at_the_end_is_not_found() -> None:
    assert not judge(_stretch((20, 0.1, True), (3, 2.0, True)), 0.0, 2.3).found


def test_right_but_never_claimed_is_not_found() -> None:
    stretch = judge(_stretch((30, 0.0, False)), 0.0, 3.0)
    assert not stretch.found
    assert stretch.claims == 0


def test_nine_right_claims_are_not_enough_and_ten_are() -> None:
    assert not judge(_stretch((21, 1.0, False), (9, 0.1, True)), 0.0, 3.0).found
    assert judge(_stretch((20, 1.0, False), (10, 0.1, True)), 0.0, 3.0).found


def test_claims_that_ceased_long_before_the_end_do_not_count() -> None:
    assert not judge(_stretch((20, 0.1, True), (40, 5.0, False)), 0.0, 6.0).found


def test_silence_is_not_found() -> None:
    stretch = judge([], 0.0, 3.0)
    assert not stretch.found
    assert stretch.noticed_after is None


def test_kidnap_is_noticed_when_the_wrong_claims_end() -> None:
    stretch = judge(_stretch((10, 0.1, True), (4, 8.0, True), (6, 8.0, False), (10, 0.1, True)), 1.0, 3.0)
    assert stretch.noticed_after == pytest.approx(0.4)
    assert stretch.found_after == pytest.approx(1.0)
    assert stretch.wrong_claims == 4


def test_a_stretch_takes_no_sightings_of_the_other() -> None:
    sightings = _stretch((10, 0.1, True), (10, 7.0, True))
    assert judge(sightings, 0.0, 1.0).found
    assert not judge(sightings, 1.0, 2.0).found


def test_the_summary_states_in_one_line_why_it_failed() -> None:
    good, bad = judge(_stretch((30, 0.1, True)), 0.0, 3.0), judge(_stretch((30, 9.0, True)), 0.0, 3.0)
    assert "found itself again" in summarize(good, good, 3.0, [])
    failed = [line for line in summarize(good, bad, 3.0, []).splitlines() if "FAILED" in line]
    assert len(failed) == 1
    assert "all 30 poses that it claimed were wrong" in failed[0]
    few = judge(_stretch((21, 1.0, False), (9, 0.1, True)), 0.0, 3.0)  # it said that the end was not right
    words = "0 of 9 claimed poses were wrong, and no 10 right ones in a row lasted to the end"
    assert words in summarize(good, few, 3.0, [])
    assert "before the kidnap (it claimed no pose)" in summarize(judge([], 0.0, 1.0), good, 3.0, [])


def test_the_candidates_are_the_most_until_the_robot_is_found() -> None:
    sightings = [
        replace(seen, candidates=number)
        for seen, number in zip(
            _stretch((7, 9.0, False), (23, 0.1, True)), [3, 14, *[2] * 5, *[20] * 23], strict=True
        )
    ]
    stretch = judge(sightings, 0.0, 3.0)
    assert stretch.candidates == 14
    text = summarize(stretch, judge(_stretch((30, 0.1, True)), 0.0, 3.0), 3.0, [])
    assert "lost for 0.7 s, 14 candidates, found after 8 scans" in text
    assert "noticed at once; found with the first scan" in text


def test_a_viewer_is_there_once_somebody_is_connected_to_its_data() -> None:
    link = "http://127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A1234%2Fproxy"
    assert data_port(link) == 1234
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert not is_watched(psutil.Process(), port)
        with socket.create_connection(("127.0.0.1", port)), server.accept()[0]:
            assert is_watched(psutil.Process(), port)
