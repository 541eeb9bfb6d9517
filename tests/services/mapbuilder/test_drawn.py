import json
import subprocess
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.eigenspace.folder import read_models
from eigenscan.geometry.gridmap import GridMap, write_map
from eigenscan.mapbuilder.drawn import divide_as_drawn, outlines
from eigenscan.mapbuilder.geojson import GivenRegion, Polygon, RegionsError, read_regions, to_geojson
from eigenscan.mapbuilder.regions import Division, Regions
from eigenscan.mapbuilder.site import Plan, lay_out
from numpy.typing import ArrayLike

from tests.command import eigenscan

ALONE = Division(margin=0.0)


def rectangle(left: float, bottom: float, right: float, top: float) -> np.ndarray:
    return np.array([[left, bottom], [right, bottom], [right, top], [left, top], [left, bottom]])


def region(name: str, *rings: ArrayLike) -> GivenRegion:
    return GivenRegion(name, (Polygon(tuple(np.asarray(ring, dtype=float) for ring in rings)),))


def collection(*features: object) -> dict[str, Any]:
    return {"type": "FeatureCollection", "features": list(features)}


def feature(ring: object, kind: str = "Polygon", **properties: object) -> dict[str, Any]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": [ring]}}


def members(regions: Regions, point: tuple[float, float]) -> set[int]:
    return {n for n, inside in enumerate(regions.members(np.array([point]))) if len(inside)}


def test_a_region_is_the_free_space_in_its_polygon(office: GridMap) -> None:
    regions = divide_as_drawn(office, [region("west", rectangle(0, 0, 7, 9))], ALONE)
    assert members(regions, (4.0, 5.0)) == {0}
    assert members(regions, (2.0, 2.0)) == {0}
    assert members(regions, (9.0, 5.0)) == set()  # in no polygon
    assert members(regions, (0.5, 0.5)) == set()  # unknown


def test_the_margin_reaches_through_doors_and_not_through_walls(office: GridMap) -> None:
    drawn = [region("hall", rectangle(1, 1, 13, 3)), region("room", rectangle(1.5, 3.2, 6.5, 7.2))]
    regions = divide_as_drawn(office, drawn, Division(margin=1.0))
    assert members(regions, (3.45, 3.6)) == {0, 1}
    assert members(regions, (5.5, 2.7)) == {0}


def test_of_overlapping_polygons_the_smallest_has_the_place_in_any_order(office: GridMap) -> None:
    large, small = region("all", rectangle(0, 0, 14, 9)), region("desk", rectangle(2, 4, 3, 5))
    for drawn in ([large, small], [small, large]):
        regions = divide_as_drawn(office, drawn, ALONE)
        assert members(regions, (2.5, 4.5)) == {drawn.index(small)}
        assert members(regions, (5.0, 5.0)) == {drawn.index(large)}


def test_a_hole_is_not_of_the_region(office: GridMap) -> None:
    with_hole = region("hall", rectangle(1, 1, 13, 3), rectangle(6, 1, 8, 3))
    regions = divide_as_drawn(office, [with_hole], ALONE)
    assert members(regions, (7.0, 2.0)) == set()
    assert members(regions, (3.0, 2.0)) == {0}


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_what_was_found_is_found_again_from_its_own_outlines(
    office: GridMap, tmp_path: Path, yaw: float
) -> None:
    grid = replace(office, origin=np.array([-3.0, 2.0, yaw]))
    plan = Plan(spacing=0.25)
    found = lay_out(grid, plan)
    file = tmp_path / "regions.geojson"
    file.write_text(to_geojson(outlines(found.regions, found.names), "map"))
    again = lay_out(grid, plan, read_regions(file))
    assert again.names == found.names
    one, other = (layout.regions.core for layout in (found, again))
    assert (one == other).mean() > 0.99
    assert json.loads(file.read_text())["frame_id"] == "map"


@pytest.mark.parametrize(
    ("content", "stated"),
    [
        ("{", "is not JSON"),
        ([], "features: give a FeatureCollection"),
        (collection(), "features: give a FeatureCollection"),
        (collection(feature([[0, 0], [1, 0], [0, 1]])), "feature 1 .*has 3 points"),
        (collection(feature([[0, 0], [1, 0], [1, "x"], [0, 0]])), "give rings of"),
        (collection(feature([[0, 0], [1, 0], [1, None], [0, 0]])), "give rings of|finite"),
        (collection(feature([[0, 0], [1, 0]], kind="LineString")), "geometry.type = 'LineString'"),
        (collection({"type": "Feature", "properties": None, "geometry": None}), "geometry.type = None"),
        (collection(feature([[0, 0]] * 4, name="a/b")), "properties.name = 'a/b'"),
        (collection(feature([[0, 0]] * 4, name="a"), feature([[0, 0]] * 4, name="a")), "given twice"),
        (collection(feature([[0, 0]] * 4, name=7)), "properties.name = 7"),
        (collection(1), "feature 1"),
    ],
)
def test_what_is_wrong_with_a_file_is_named(tmp_path: Path, content: object, stated: str) -> None:
    file = tmp_path / "rooms.geojson"
    file.write_text(content if isinstance(content, str) else json.dumps(content))
    with pytest.raises(RegionsError, match=stated) as error:
        read_regions(file)
    assert "rooms.geojson" in str(error.value)


def test_a_region_without_free_space_is_named(office: GridMap) -> None:
    with pytest.raises(RegionsError, match="'moon' holds no free space"):
        divide_as_drawn(office, [region("moon", rectangle(500, 500, 510, 510))], ALONE)


def build(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return eigenscan("build", *arguments)


def test_build_takes_regions_and_leaves_them_to_be_edited(office: GridMap, tmp_path: Path) -> None:
    write_map(office, tmp_path / "office.yaml")
    rooms = tmp_path / "rooms.geojson"
    ring = rectangle(1, 1, 13, 3).tolist()
    rooms.write_text(json.dumps(collection(feature(ring, name="hall"))))
    done = build(tmp_path / "office.yaml", "-o", tmp_path / "model", "--regions", rooms, "--step", "2")
    assert done.returncode == 0, done.stderr
    (model,) = read_models(tmp_path / "model").regions
    assert model.region == "hall"
    (left,) = read_regions(tmp_path / "model/regions.geojson")
    assert left.name == "hall"

    rooms.write_text(json.dumps(collection(feature(rectangle(90, 90, 99, 99).tolist(), name="moon"))))
    done = build(tmp_path / "office.yaml", "-o", tmp_path / "other", "--regions", rooms)
    assert done.returncode == 2
    assert "rooms.geojson: region 'moon' holds no free space" in done.stderr
    assert not (tmp_path / "other").exists()


@pytest.mark.parametrize("name", ["a\0b", "a\nb", "\ud800", "😀" * 51, "a@b"])
def test_a_name_that_no_file_or_key_can_have_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "regions.geojson"
    path.write_text(json.dumps(collection(feature(rectangle(0, 0, 7, 9).tolist(), name=name))))
    with pytest.raises(RegionsError, match=r"feature 1: properties.name"):
        read_regions(path)


def test_many_regions_on_a_large_map_take_no_mask_each() -> None:
    """A hundred rooms on a square kilometre took 10 GB."""
    grid = GridMap(np.zeros((1500, 1500), dtype=np.uint8), 0.1, np.zeros(3))
    drawn = [region(f"r{n}", rectangle(n, 0, n + 1, 10)) for n in range(100)]
    tracemalloc.start()
    divide_as_drawn(grid, drawn, ALONE)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40 * grid.cells.size
