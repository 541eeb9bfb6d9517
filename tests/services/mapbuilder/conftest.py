import pytest
from eigenscan.geometry.gridmap import GridMap

from tests.services.mapbuilder.floorplan import two_rooms


@pytest.fixture
def office() -> GridMap:
    return two_rooms()
