"""Numbers of a message by its bytes are those that protobuf gives one by one, to the bit."""

import numpy as np
import pytest
from eigenscan.geometry.message_floats import floats_of, put_floats
from eigenscan.schemas.hypotheses_pb2 import Obstacles
from eigenscan.schemas.scan_pb2 import RawScan, Scan
from eigenscan.schemas.wire import encode

STRANGE = [0.0, -0.0, np.nan, np.inf, -np.inf, 1e-45, 3.4028235e38, 0.1]


def _numbers(count: int) -> np.ndarray:
    random = np.random.default_rng(count)
    return np.concatenate([STRANGE, random.normal(0.0, 10.0, count)])[:count].astype(np.float32)


@pytest.mark.parametrize("count", [0, 1, 8, 31, 32, 361, 5_000])
def test_numbers_come_as_they_went_in(count: int) -> None:
    wanted = _numbers(count)
    for kind in (RawScan, Scan):
        scan = kind(frame_id="base", angle_min=0.5, ranges=wanted.tolist())
        found = floats_of(scan, "ranges")
        assert found.dtype == np.float32
        assert found.tobytes() == np.fromiter(scan.ranges, np.float32, count).tobytes()
        found[:] = 1.0  # its own: the message stays
        assert np.array_equal(np.asarray(scan.ranges, np.float32), wanted, equal_nan=True)


@pytest.mark.parametrize("count", [0, 1, 8, 31, 32, 361, 5_000])
def test_a_message_is_the_same_as_if_made_number_by_number(count: int) -> None:
    numbers = _numbers(count)
    scan, obstacles = RawScan(frame_id="base"), Obstacles(error_energy=0.5)
    put_floats(scan, RawScan.RANGES_FIELD_NUMBER, numbers)
    put_floats(obstacles, Obstacles.MAP_X_FIELD_NUMBER, numbers)
    assert encode(scan) == encode(RawScan(frame_id="base", ranges=numbers.tolist()))
    assert encode(obstacles) == encode(Obstacles(error_energy=0.5, map_x=numbers.tolist()))
