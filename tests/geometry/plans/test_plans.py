"""Floor plans become the maps that they show."""

import tracemalloc
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, MapError, write_map
from eigenscan.geometry.plans import PlanOptions, raster, read_plan
from eigenscan.geometry.plans.raster import Walls, rasterize
from ezdxf import units as dxf_units
from ezdxf.filemanagement import new
from ezdxf.layouts.layout import Modelspace
from scipy.ndimage import distance_transform_edt

from tests.command import eigenscan

# two rooms, 10 m by 6 m, a door of 1 m between them and one of 1 m to the outside; a pillar in the left room
ROOM_LEFT, ROOM_RIGHT, DOOR = (2.0, 1.0), (8.0, 4.0), (5.0, 3.5)
PILLAR, OUTSIDE = (2.5, 4.0), (10.5, 3.0)
INNER, OUTER = [(5, 0), (5, 3), (5, 4), (5, 6)], [(10, 2.5), (10, 0), (0, 0), (0, 6), (10, 6), (10, 3.5)]


def _draw(space: Modelspace, unit: float) -> None:
    def at(x: float, y: float) -> tuple[float, float]:
        return x / unit, y / unit

    space.add_lwpolyline([at(*point) for point in OUTER], dxfattribs={"layer": "WALLS"})
    space.add_line(at(*INNER[0]), at(*INNER[1]), dxfattribs={"layer": "WALLS"})
    space.add_line(at(*INNER[2]), at(*INNER[3]), dxfattribs={"layer": "WALLS"})
    space.add_blockref("PILLAR", at(*PILLAR), dxfattribs={"layer": "WALLS"})
    space.add_line(at(5, 3), at(5, 4), dxfattribs={"layer": "DOORS"})
    space.add_text("hall", height=1 / unit, dxfattribs={"insert": at(1, 1)})


def _dxf(folder: Path, units: int, unit: float) -> Path:
    drawing = new(units=units)
    drawing.blocks.new("PILLAR").add_circle((0, 0), 0.3 / unit)
    _draw(drawing.modelspace(), unit)
    path = folder / "plan.dxf"
    drawing.saveas(path)
    return path


def _svg(folder: Path) -> Path:
    def way(points: Sequence[tuple[float, float]]) -> str:
        return "M" + " L".join(f"{100 * x + 20},{620 - 100 * y}" for x, y in points)

    path = folder / "plan.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1100 700">'
        '<rect width="1100" height="700" fill="white"/><g id="walls" stroke="black" fill="none">'
        f'<path d="{way(OUTER)}"/><path d="{way(INNER[:2])} {way(INNER[2:])}"/>'
        f'<circle cx="{100 * PILLAR[0] + 20}" cy="{620 - 100 * PILLAR[1]}" r="30" fill="#333"/></g>'
        f'<g id="doors"><path stroke="red" d="{way(INNER[1:3])}"/></g></svg>'
    )
    return path


def _expect_rooms(grid: GridMap, door: int = FREE) -> None:
    assert grid.at(np.array([ROOM_LEFT, ROOM_RIGHT])).tolist() == [FREE, FREE]
    assert grid.at(np.array([PILLAR, OUTSIDE])).tolist() == [OCCUPIED, UNKNOWN]
    # the line's two cells lie to either side of it
    beside = grid.at(np.array([[x + off, y] for x, y in (DOOR, (5.0, 1.0)) for off in (-0.03, 0.03)]))
    assert (beside[:2] == OCCUPIED).any() == (door == OCCUPIED)
    assert (beside[2:] == OCCUPIED).any()
    # walls take 5 cm to either side of their line
    assert grid.free_area == pytest.approx(60 - np.pi * 0.35**2 - 0.05 * 31 - 0.1 * 5, abs=0.3)


@pytest.mark.parametrize(
    ("units", "unit", "published"),
    [
        (dxf_units.MM, 0.001, None),
        (dxf_units.M, 1.0, None),
        (dxf_units.IN, 0.0254, None),
        (0, 0.01, 0.01),
        (dxf_units.MM, 0.5, 0.5),
    ],
)
def test_a_dxf_in_any_unit(tmp_path: Path, units: int, unit: float, published: float | None) -> None:
    _expect_rooms(read_plan(_dxf(tmp_path, units, unit), PlanOptions(published, ("WALLS",))))


def test_all_layers_count_where_none_is_named(tmp_path: Path) -> None:
    _expect_rooms(read_plan(_dxf(tmp_path, dxf_units.MM, 0.001), PlanOptions()), door=OCCUPIED)


def test_an_svg_stands_upright_and_its_paper_is_no_wall(tmp_path: Path) -> None:
    path = _svg(tmp_path)
    _expect_rooms(read_plan(path, PlanOptions(0.01, ("walls",))))
    _expect_rooms(read_plan(path, PlanOptions(0.01)), door=OCCUPIED)


def test_the_inside_of_a_double_wall_is_wall(tmp_path: Path) -> None:
    drawing = new(units=dxf_units.M)
    for grown in (0.0, 0.4):
        low, high = -grown, 6 + grown
        drawing.modelspace().add_lwpolyline([(low, low), (high, low), (high, high), (low, high)], close=True)
    drawing.saveas(tmp_path / "plan.dxf")
    grid = read_plan(tmp_path / "plan.dxf", PlanOptions())
    assert grid.at(np.array([[3, 3], [3, -0.2], [-0.2, 6.2], [3, -0.6]])).tolist() == [0, 100, 100, 255]


def test_an_image_with_a_scale(tmp_path: Path) -> None:
    plan = read_plan(_dxf(tmp_path, dxf_units.MM, 0.001), PlanOptions(layers=("WALLS",)))
    write_map(plan, tmp_path / "map.yaml")
    grid = read_plan(tmp_path / "map.pgm", PlanOptions(0.1))
    assert grid.free_area == pytest.approx(4 * plan.free_area)


def test_what_is_wrong_names_the_fix(tmp_path: Path) -> None:
    dxf, svg = _dxf(tmp_path, 0, 1.0), _svg(tmp_path)
    (tmp_path / "bad.dxf").write_text("rubbish")
    (tmp_path / "bad.svg").write_text("<svg")
    (tmp_path / "empty.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    (tmp_path / "picture.png").write_text("rubbish")
    for path, options, words in (
        (dxf, PlanOptions(), "--metres-per-unit"),
        (dxf, PlanOptions(1.0, ("WAND",)), "no wall on the layer WAND: choose one of DOORS, WALLS"),
        (dxf, PlanOptions(1000.0), "too large"),
        (dxf, PlanOptions(0.01), "enclose nothing"),
        (svg, PlanOptions(), "--metres-per-unit"),
        (svg, PlanOptions(0.01, ("wand",)), "no group with the id or label wand"),
        (svg, PlanOptions(0.01, ("walls", "wand")), "no group with the id or label wand"),
        (tmp_path / "bad.dxf", PlanOptions(), "no DXF that can be read"),
        (tmp_path / "bad.svg", PlanOptions(1.0), "no SVG that can be read"),
        (tmp_path / "empty.svg", PlanOptions(1.0), "no wall in it"),
        (tmp_path / "picture.png", PlanOptions(), "m a pixel"),
        (tmp_path / "picture.png", PlanOptions(0.05), "cannot be read"),
        (tmp_path / "absent.dxf", PlanOptions(), "is not there"),
        (tmp_path / "map.yaml", PlanOptions(0.05), "leave --metres-per-unit out"),
    ):
        with pytest.raises(MapError) as raised:
            read_plan(path, options)
        assert str(raised.value).startswith(f"{path}: ")
        assert words in str(raised.value)


def test_models_are_built_of_a_plan(tmp_path: Path) -> None:
    _dxf(tmp_path, dxf_units.MM, 0.001)
    done = eigenscan("build", "plan.dxf", "-o", "model", "--step", 2, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "model/map.yaml").is_file()


def test_blocks_that_repeat_each_other_without_end_are_refused(tmp_path: Path) -> None:
    drawing = new(units=dxf_units.M)
    drawing.blocks.new("B0").add_line((0, 0), (1, 0))
    for level in range(1, 9):
        block = drawing.blocks.new(f"B{level}")
        for _ in range(10):
            block.add_blockref(f"B{level - 1}", (0, 0))
    drawing.modelspace().add_blockref("B8", (0, 0))
    drawing.saveas(tmp_path / "bomb.dxf")
    with pytest.raises(MapError, match=r"bomb\.dxf.*shapes"):
        read_plan(tmp_path / "bomb.dxf", PlanOptions())


def test_a_block_in_rows_and_columns_without_end_is_refused(tmp_path: Path) -> None:
    drawing = new(units=dxf_units.M)
    drawing.blocks.new("B0").add_line((0, 0), (1, 0))
    rows_and_columns = {"row_count": 30_000, "column_count": 30_000, "row_spacing": 1, "column_spacing": 1}
    drawing.modelspace().add_blockref("B0", (0, 0), rows_and_columns)
    drawing.saveas(tmp_path / "bomb.dxf")
    with pytest.raises(MapError, match=r"bomb\.dxf.*shapes"):
        read_plan(tmp_path / "bomb.dxf", PlanOptions())


@pytest.mark.parametrize("itself", [False, True])
def test_uses_that_repeat_each_other_without_end_are_refused(tmp_path: Path, itself: bool) -> None:
    levels = ['<g id="g0"><path d="M0,0 L1,0" stroke="black"/></g>']
    levels += [f'<g id="g{n}">' + f'<use href="#g{n - 1}"/>' * 10 + "</g>" for n in range(1, 9)]
    last = '<g id="round"><use href="#round"/></g>' if itself else '<use href="#g8"/>'
    path = tmp_path / "bomb.svg"
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg">{"".join(levels)}{last}</svg>')
    with pytest.raises(MapError, match=r"bomb\.svg"):
        read_plan(path, PlanOptions(metres_per_unit=0.01))


def test_an_empty_hall_takes_few_bytes_a_cell() -> None:
    """Fuzzing: a drawing of 392 bytes and 5 million cells took 206 MB."""
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.5], [0.0, 0.5], [0.0, 0.0]])
    rasterize(Path("small.svg"), Walls([10.0 * corners]), 0.05)  # what is imported late does not count
    tracemalloc.start()
    try:
        hall = rasterize(Path("hall.svg"), Walls([100.0 * corners]), 0.05)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 25 * hall.cells.size
    assert hall.cells[hall.cells.shape[0] // 2, hall.cells.shape[1] // 2] == FREE
    assert hall.cells[0, 0] == UNKNOWN


def test_distances_found_in_bands_are_those_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    there = np.random.default_rng(1).random((90, 40)) > 0.995
    far_m, resolution = 0.6, 0.05
    monkeypatch.setattr(raster, "BAND_CELLS", 1)
    expected = distance_transform_edt(~there) * resolution <= far_m
    assert 0 < expected.sum() < expected.size
    np.testing.assert_array_equal(raster._near(there, far_m, resolution), expected)


@pytest.mark.parametrize("scale", [-0.01, 0.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["plan.dxf", "plan.svg"])
def test_a_scale_that_is_none_is_refused_before_the_drawing_is_read(
    tmp_path: Path, name: str, scale: float
) -> None:
    """A DXF with a circle took for ever at a negative one; an SVG was turned by half a turn."""
    (tmp_path / name).touch()
    with pytest.raises(MapError, match=f"{name}: --metres-per-unit {scale:g}: give metres above 0"):
        read_plan(tmp_path / name, PlanOptions(scale))


def test_a_filled_point_is_no_wall(tmp_path: Path) -> None:
    square = np.array([[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]], dtype=np.float64)
    alone = rasterize(tmp_path, Walls([square]), 0.05)
    with_point = rasterize(tmp_path, Walls([square], [square[:1] + 2.0]), 0.05)
    np.testing.assert_array_equal(with_point.cells, alone.cells)
