import numpy as np
import pytest
from eigenscan.eigenspace.panorama import Sensor, resample
from eigenscan.geometry.circle import difference
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster


def room() -> GridMap:
    cells = np.full((90, 140), FREE, dtype=np.uint8)
    cells[[0, -1], :] = cells[:, [0, -1]] = OCCUPIED
    cells[30:50, 90:100] = OCCUPIED
    return GridMap(cells, 0.05, np.array([-1.0, 2.0, 0.3]))


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor.facing(np.pi, np.deg2rad(0.5)),
        Sensor(-2.1, np.deg2rad(1), 230),
        Sensor(0.4, np.deg2rad(2), 180),
    ],
)
def test_a_window_is_what_the_sensor_sees_at_its_heading(sensor: Sensor) -> None:
    grid, point, turn = room(), np.array([0.7, 4.1]), sensor.turn
    panorama = RayCaster.of(grid).panoramas(point[None], turn, 50.0)
    for k in (0, 1, turn // 3, turn - 1):
        heading = sensor.headings(turn)[k]
        bearings = sensor.angle_min + np.arange(sensor.beams) * sensor.angle_increment
        scan = RayCaster.of(grid).cast([[*point, heading]], bearings, 50.0)
        window = np.roll(panorama, -k, axis=1)[:, : sensor.beams]
        assert (np.abs(window - scan) < 1e-3).mean() > 0.99


def test_headings_go_once_round() -> None:
    sensor = Sensor(-1.234, np.deg2rad(0.5), 400)
    headings = sensor.headings(720)
    assert ((headings >= -np.pi) & (headings < np.pi)).all()
    assert np.abs(difference(headings[1:], headings[:-1]) - np.deg2rad(0.5)).max() < 1e-9


def test_a_sensor_that_does_not_see_all_round_has_a_beam_at_either_end() -> None:
    papers = Sensor.facing(np.pi, np.deg2rad(0.5))
    assert (papers.beams, papers.turn) == (361, 720)
    assert Sensor.facing(2 * np.pi, np.deg2rad(0.5)).beams == 720


@pytest.mark.parametrize("turn", [360, 1000, 1024, 1440, 719])
def test_resampling_is_nearly_casting_at_the_other_step(turn: int) -> None:
    grid, points = room(), np.array([[0.7, 4.1], [3.0, 4.6]])
    fine = resample(RayCaster.of(grid).panoramas(points, 720, 50.0), turn)
    cast = RayCaster.of(grid).panoramas(points, turn, 50.0)
    # but beside the corners of the pillar, where the nearer of two walls in angle counts
    assert (np.abs(fine - cast) < 0.06).mean() > 0.98


def test_resampling_is_exact_on_a_straight_wall_and_keeps_no_wall() -> None:
    angle = np.arange(720) * (2 * np.pi / 720)
    with np.errstate(divide="ignore"):
        wall = np.where(np.cos(angle) > 0.2, 3.0 / np.cos(angle), np.inf).astype(np.float32)
    at = np.arange(1000) * (2 * np.pi / 1000)
    inside = np.cos(at) > 0.22
    np.testing.assert_allclose(resample(wall, 1000)[inside], (3.0 / np.cos(at))[inside], rtol=1e-4)
    assert np.isinf(resample(wall, 1000)[np.cos(at) < 0.18]).all()
    assert not np.isnan(resample(wall, 1000)).any()
    assert resample(wall, 720) is wall
