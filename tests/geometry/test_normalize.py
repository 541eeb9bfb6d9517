import math

import numpy as np
import pytest
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.normalize import (
    ScanError,
    Sweep,
    limit,
    orient,
    own_beams,
    resample,
)
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.typing import NDArray

# written out, not taken from what is tested: a change there must show here
SURFACE_NOISE = 0.03
GRAZING = math.tan(math.radians(75.0))

INF, NAN = math.inf, math.nan


def sweep(ranges: list[float] | NDArray[np.float64], first: float, step: float) -> Sweep:
    return Sweep(np.asarray(ranges, dtype=np.float32), first, step)


def seen_from_above(raw: Sweep, upside_down: bool) -> set[tuple[float, float]]:
    """Endpoints one by one: a head-down sensor's left is right."""
    points = set()
    for number, reach in enumerate(raw.ranges.tolist()):
        angle = raw.angle_min + number * raw.angle_increment
        y = reach * math.sin(angle)
        points.add((round(reach * math.cos(angle), 4), round(-y if upside_down else y, 4)))
    return points


@given(
    ranges=st.lists(st.floats(0.125, 10.0, width=32), min_size=2, max_size=40),
    first=st.floats(-7.0, 7.0),
    span=st.floats(0.05, 6.2),
    clockwise=st.booleans(),
    upside_down=st.booleans(),
)
def test_orient_keeps_every_endpoint_and_runs_counter_clockwise(
    ranges: list[float], first: float, span: float, clockwise: bool, upside_down: bool
) -> None:
    step = min(span / (len(ranges) - 1), math.pi) * (-1 if clockwise else 1)
    raw = sweep(ranges, first, step)
    got = orient(raw, upside_down)
    assert got.angle_increment > 0
    assert -math.pi <= got.angle_min < math.pi
    expected = np.array(sorted(seen_from_above(raw, upside_down)))
    assert np.abs(np.array(sorted(seen_from_above(got, False))) - expected).max() < 1e-3


@pytest.mark.parametrize(
    ("first", "step", "count", "reason"),
    [
        (NAN, 0.1, 5, "angles_not_finite"),
        (0.0, INF, 5, "angles_not_finite"),
        (0.0, 0.0, 5, "angle_increment_zero"),
        (-90.0, 1.0, 181, "over_a_turn"),  # degrees
        (0.0, -1.0, 9, "over_a_turn"),
        (0.0, 3.15, 1, "over_a_turn"),
        (0.0, -3.15, 3, "over_a_turn"),
    ],
)
def test_angles_that_make_no_sense_are_refused(first: float, step: float, count: int, reason: str) -> None:
    with pytest.raises(ScanError) as caught:
        orient(sweep([1.0] * count, first, step), False)
    assert caught.value.reason == reason


def test_a_full_turn_with_both_ends_is_no_error() -> None:
    assert len(orient(sweep([1.0] * 361, -math.pi, math.radians(1.0)), False).ranges) == 361


@pytest.mark.parametrize("beams", [1, 2, 3])
def test_beams_half_a_turn_apart_make_sense(beams: int) -> None:
    assert len(orient(sweep([1.0] * beams, 0.0, -math.pi), False).ranges) == beams


def test_limits_distinguish_missing_from_no_return() -> None:
    raw = np.array([NAN, -INF, -1.0, 0.0, 0.05, 0.1, 5.0, 29.9, 29.98, 30.0, 31.0, INF], dtype=np.float32)
    got = limit(raw, 0.1, 30.0)
    assert np.isnan(got[:5]).all()
    np.testing.assert_array_equal(got[5:8], raw[5:8])
    assert np.isposinf(got[8:]).all()
    assert raw[3] == 0.0, "the driver's ranges stay as they are"


def test_without_a_stated_maximum_only_infinity_is_no_return() -> None:
    got = limit(np.array([0.0, 500.0, INF, NAN], dtype=np.float32), 0.0, 0.0)
    np.testing.assert_array_equal(got, np.array([NAN, 500.0, INF, NAN], dtype=np.float32))


@given(
    ranges=st.lists(st.floats(0.5, 10.0, width=32), min_size=40, max_size=80),
    lost=st.sets(st.integers(0, 39), max_size=6),
    apart=st.integers(2, 4),
    first=st.integers(0, 3),
    empty=st.sampled_from([NAN, INF]),
)
def test_beams_between_those_that_measure_are_left_out(
    ranges: list[float], lost: set[int], apart: int, first: int, empty: float
) -> None:
    """Some drivers write a finer grid than the lidar has."""
    own = np.array(
        [NAN if number in lost else reach for number, reach in enumerate(ranges)], dtype=np.float32
    )
    spread = np.full(len(own) * apart, empty, dtype=np.float32)
    spread[first % apart :: apart] = own
    got = own_beams(sweep(spread.astype(np.float64), -1.0, 0.01))
    known = np.isfinite(own)
    np.testing.assert_array_equal(got.ranges[np.isfinite(got.ranges)], own[known])
    directions = -1.0 + 0.01 * (np.flatnonzero(known) * apart + first % apart)
    found = got.angle_min + got.angle_increment * np.flatnonzero(np.isfinite(got.ranges))
    np.testing.assert_allclose(found, directions, atol=1e-9)
    assert len(got.ranges) == len(own)


@pytest.mark.parametrize("empty", [[], [4, 5, 30], list(range(0, 61)), list(range(1, 90, 2))])
def test_a_scan_with_two_neighbours_or_few_ranges_stays_as_it_is(empty: list[int]) -> None:
    ranges = np.full(90, 2.0)
    ranges[empty] = NAN
    if len(empty) > 40:
        ranges[::3] = NAN  # of each second beam fewer than 32 are left
    given_ = sweep(ranges, 0.0, 0.01)
    assert own_beams(given_) is given_


def in_a_room(x: float, y: float, angles: np.ndarray) -> NDArray[np.float64]:
    """Ranges to the walls of a room 6 m x 4 m, from (x, y)."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore", over="ignore"):
        to_x = np.where(cos > 0, (6.0 - x) / cos, -x / cos)
        to_y = np.where(sin > 0, (4.0 - y) / sin, -y / sin)
    return np.minimum(np.abs(to_x), np.abs(to_y))


@given(
    x=st.floats(2.0, 4.0),
    y=st.floats(1.3, 2.7),
    first=st.floats(-3.0, 1.0),
    own=st.floats(0.2, 1.5),
    step=st.floats(0.2, 2.0),
)
def test_flat_walls_are_met_exactly(x: float, y: float, first: float, own: float, step: float) -> None:
    angles = first + math.radians(own) * np.arange(int(100 / own))
    got = resample(sweep(in_a_room(x, y, angles), first, math.radians(own)), math.radians(step))
    wanted = got.angle_min + got.angle_increment * np.arange(len(got.ranges))
    # off its beams nothing is claimed; inside, only the chord across a corner deviates
    inner = (wanted >= angles[0]) & (wanted <= angles[-1])
    error = np.abs(got.ranges - in_a_room(x, y, wanted))[inner]
    assert np.isfinite(got.ranges).all()
    assert np.quantile(error, 0.9) < 1e-4
    assert error.max() < 0.1


grids = st.tuples(st.floats(-3.0, 1.0), st.floats(0.2, 4.0), st.floats(0.2, 4.0))
any_range = st.one_of(st.floats(0.125, 30.0, width=32), st.sampled_from([NAN, INF]))


@given(ranges=st.lists(any_range, min_size=2, max_size=60), grid=grids)
def test_nothing_is_made_up(ranges: list[float], grid: tuple[float, float, float]) -> None:
    """Each range lies between those of its two neighbours, and is one of them where they differ by a jump."""
    first, own, step = grid[0], math.radians(grid[1]), math.radians(grid[2])
    raw = sweep(ranges, first, own)
    got = resample(raw, step)
    for number, value in enumerate(got.ranges.tolist()):
        position = (got.angle_min + number * step - first) / own
        left = min(max(math.floor(position + 1e-9), 0), len(ranges) - 1)
        right = min(left + 1, len(ranges) - 1)
        a, b = float(raw.ranges[left]), float(raw.ranges[right])
        if math.isnan(value):
            continue
        if math.isinf(value) or not (math.isfinite(a) and math.isfinite(b)):
            assert value in (a, b)
            continue
        # a chord bends towards the sensor by at most 1 - cos of half the step
        assert min(a, b) * math.cos(own / 2) - 1e-4 <= value <= max(a, b) + 1e-4
        if abs(a - b) > SURFACE_NOISE + min(a, b) * own * GRAZING + 1e-4:
            assert value in (a, b)
            reach = position - left if value == a else left + 1 - position
            assert reach * own <= 0.5 * step + 1e-6


@given(ranges=st.lists(any_range, min_size=2, max_size=60), start=st.integers(-60, 60))
def test_its_own_grid_changes_nothing(ranges: list[float], start: int) -> None:
    step = math.radians(1.5)
    raw = sweep(ranges, start * step, step)
    got = resample(raw, step)
    np.testing.assert_array_equal(got.ranges, raw.ranges)
    assert got.angle_min == pytest.approx(start * step, abs=1e-12)


@pytest.mark.parametrize("own_count", [360, 361, 720, 1440])
@pytest.mark.parametrize("first", [-math.pi, 0.0, -1.2345])
def test_a_full_turn_stays_one(own_count: int, first: float) -> None:
    own = TURN / (own_count - own_count % 2)
    angles = first + own * np.arange(own_count)
    got = resample(sweep(in_a_room(2.0, 1.5, angles), first, own), math.radians(0.5))
    assert len(got.ranges) == 720
    wanted = got.angle_min + got.angle_increment * np.arange(720)
    assert np.isfinite(got.ranges).all()
    assert np.abs(got.ranges - in_a_room(2.0, 1.5, wanted)).max() < 0.1


def test_the_grid_is_the_same_for_every_start_of_the_sweep() -> None:
    step = math.radians(0.5)
    for first in np.linspace(-1.0, 1.0, 17):
        got = resample(sweep([2.0] * 100, float(first), math.radians(0.7)), step)
        assert got.angle_min / step == pytest.approx(round(got.angle_min / step), abs=1e-6)


@given(step=st.floats(0.1, 5.0), beams=st.integers(1, 50))
def test_the_grid_stays_within_the_field_of_view(step: float, beams: int) -> None:
    own = math.radians(1.0)
    assume(beams > 1)
    got = resample(sweep([1.0] * beams, -0.3, own), math.radians(step))
    last = got.angle_min + (len(got.ranges) - 1) * got.angle_increment
    margin = 0.5 * min(own, math.radians(step)) + 1e-5
    if len(got.ranges) > 1:
        assert got.angle_min >= -0.3 - margin
        assert last <= -0.3 + (beams - 1) * own + margin
