import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.geometry.gridmap import (
    FREE,
    OCCUPIED,
    UNKNOWN,
    GridMap,
    MapError,
    check_grid,
    from_message,
    read_map,
    to_message,
    write_map,
)
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from PIL import EpsImagePlugin, Image


def saved(folder: Path, pixels: ArrayLike, image: str = "map.pgm", **meta: object) -> Path:
    """A map_server pair; `pixels` as an image shows them, first row on top."""
    Image.fromarray(np.array(pixels, dtype=np.uint8)).save(folder / image)
    fields = {"image": image, "resolution": 0.1, "origin": [0, 0, 0], "negate": 0} | meta
    fields = {"occupied_thresh": 0.65, "free_thresh": 0.196} | fields
    path = folder / "map.yaml"
    path.write_text("\n".join(f"{k}: {v}" for k, v in fields.items() if v is not None))
    return path


PIXELS = [[0, 205, 254], [254, 254, 100]]


def test_the_bottom_row_of_the_image_is_row_0(tmp_path: Path) -> None:
    grid = read_map(saved(tmp_path, PIXELS))
    assert grid.cells.tolist() == [[FREE, FREE, UNKNOWN], [OCCUPIED, UNKNOWN, FREE]]


def test_negated(tmp_path: Path) -> None:
    grid = read_map(saved(tmp_path, [[255, 50, 1], [1, 1, 120]], negate=1))
    assert grid.cells.tolist() == [[FREE, FREE, UNKNOWN], [OCCUPIED, UNKNOWN, FREE]]


def test_the_thresholds_are_the_files(tmp_path: Path) -> None:
    path = saved(tmp_path, [[100, 180, 254]], occupied_thresh=0.6, free_thresh=0.3)
    assert read_map(path).cells.tolist() == [[OCCUPIED, FREE, FREE]]


def test_a_savers_unknown_stays_unknown_under_nav2s_threshold(tmp_path: Path) -> None:
    assert read_map(saved(tmp_path, PIXELS, free_thresh=0.25)).cells[1, 1] == UNKNOWN
    # where nothing is lighter, 205 may well be the free space
    assert read_map(saved(tmp_path, [[0, 205]], free_thresh=0.25)).cells.tolist() == [[OCCUPIED, FREE]]
    scale = saved(tmp_path, PIXELS, free_thresh=0.25, mode="scale")
    assert read_map(scale).cells[1, 1] == FREE


@pytest.mark.parametrize("mode", ["trinary", "scale"])
def test_what_is_transparent_is_unknown(tmp_path: Path, mode: str) -> None:
    """Of a trinary map transparent white was free: the surroundings of a building."""
    pixels = [[[0, 0, 0, 255], [255, 255, 255, 0], [255, 255, 255, 255], [128, 128, 128, 255]]]
    path = saved(tmp_path, pixels, image="map.png", mode=mode)
    assert read_map(path).cells.tolist() == [[OCCUPIED, UNKNOWN, FREE, UNKNOWN]]


def test_raw_holds_occupancy_itself(tmp_path: Path) -> None:
    path = saved(tmp_path, [[0, 100, 255, 49, 50, 101]], mode="raw")
    assert read_map(path).cells.tolist() == [[FREE, OCCUPIED, UNKNOWN, FREE, OCCUPIED, UNKNOWN]]


@pytest.mark.parametrize(
    ("meta", "stated"),
    [
        ({"occupied_thresh": 65}, "occupied_thresh = 65: give a share, 0 to 1"),
        ({"resolution": None}, "resolution is missing"),
        ({"resolution": 0}, "resolution = 0"),
        ({"resolution": -0.05}, "resolution"),
        ({"resolution": 5.0}, "resolution = 5.0: give metres per pixel, such as 0.05"),
        ({"resolution": ".nan"}, "resolution"),
        ({"resolution": "fine"}, "resolution = 'fine'"),
        ({"origin": None}, "origin is missing"),
        ({"origin": "[0, 0]"}, "origin"),
        ({"origin": "[0, 0, .inf]"}, "origin"),
        ({"mode": "binary"}, "mode = 'binary'"),
        ({"occupied_thresh": "high"}, "occupied_thresh"),
        ({"negate": "maybe"}, "negate = 'maybe': give 0 or 1"),
        ({"free_thresh": 0.7}, "free_thresh = 0.7 is above occupied_thresh = 0.65"),
        ({"image": "none.pgm"}, "none.pgm is missing: correct"),
        ({"negate": 1, "free_thresh": 0.0}, "no free cell"),
        ({"occupied_thresh": 1.0}, "no occupied cell in"),  # as in an image that is all white
    ],
)
def test_a_bad_field_is_named_with_its_file(tmp_path: Path, meta: dict[str, Any], stated: str) -> None:
    path = saved(tmp_path, PIXELS)
    saved(tmp_path, PIXELS, **({"image": "map.pgm"} | meta)) if "image" not in meta else path.write_text(
        path.read_text().replace("map.pgm", meta["image"])
    )
    with pytest.raises(MapError, match=stated) as error:
        read_map(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(("written", "mode"), [("Trinary", "trinary"), ("RAW", "raw")])
def test_a_mode_may_have_capitals(tmp_path: Path, written: str, mode: str) -> None:
    """As in Nav2."""
    expected = read_map(saved(tmp_path, PIXELS, mode=mode)).cells.tolist()
    assert read_map(saved(tmp_path, PIXELS, mode=written)).cells.tolist() == expected


def test_a_comment_may_be_in_another_encoding(tmp_path: Path) -> None:
    path = saved(tmp_path, PIXELS)
    path.write_bytes("# Gebäude 3, Flur\n".encode("latin-1") + path.read_bytes())
    assert read_map(path).cells[0, 0] == FREE


def test_a_mistake_in_the_yaml_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text("image: map.pgm\norigin: [0, 0\nresolution: 0.05\n")
    with pytest.raises(MapError, match=r"map\.yaml, line 3: is no map_server yaml"):
        read_map(path)


def test_a_tab_in_the_yaml_is_named(tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text("image:\tmap.pgm\n")
    with pytest.raises(MapError, match=r"line 1: is no map_server yaml \(found character '\\t'"):
        read_map(tmp_path / "map.yaml")


@pytest.mark.parametrize("text", ["", "- a\n- b", "image: [", "just words"])
def test_what_is_no_map_file(tmp_path: Path, text: str) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(MapError):
        read_map(path)
    with pytest.raises(MapError, match="cannot be read"):
        read_map(tmp_path / "none.yaml")


def some_map(origin: tuple[float, float, float] = (1.5, -2.25, 0.7)) -> GridMap:
    cells = np.random.default_rng(2).choice(np.array([FREE, OCCUPIED, UNKNOWN], np.uint8), (7, 11))
    return GridMap(cells, 0.05, np.array(origin))


def test_a_map_comes_back_from_disk_and_from_the_wire(tmp_path: Path) -> None:
    grid = replace(some_map(), resolution=np.float64(0.05))
    write_map(grid, tmp_path / "a" / "map.yaml")
    for back in (read_map(tmp_path / "a" / "map.yaml"), from_message(to_message(grid, "map"))):
        np.testing.assert_array_equal(back.cells, grid.cells)
        np.testing.assert_allclose(back.origin, grid.origin, atol=1e-12)
        assert back.resolution == grid.resolution
    assert read_map(tmp_path / "a" / "map.yaml").version == grid.version


def test_a_map_that_cannot_be_written_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, file = some_map(), tmp_path / "map.yaml"
    write_map(before, file)

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as broken:
        broken.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="No space left"):
            write_map(replace(before, cells=before.cells[::-1]), file)
    assert read_map(file).version == before.version
    assert sorted(each.name for each in tmp_path.iterdir()) == ["map.pgm", "map.yaml"]


def test_grids_that_are_no_maps() -> None:
    good = to_message(some_map(), "map")
    for change in (
        {"column_count": 0},
        {"cell_stride": 2},
        {"data": b"123"},
        {"data": b""},
        {"row_stride": 3},
    ):
        bad = type(good)()
        bad.CopyFrom(good)
        for name, value in change.items():
            setattr(bad, name, value)
        with pytest.raises(MapError):
            from_message(bad)
    good.cell_size.y = 0.1
    with pytest.raises(MapError, match="squares"):
        from_message(good)


@given(x=st.floats(-50, 50), y=st.floats(-50, 50), yaw=st.floats(-7, 7))
def test_map_and_grid_coordinates_are_each_others_inverse(x: float, y: float, yaw: float) -> None:
    grid = some_map((x, y, yaw))
    cells = np.array([[0.5, 0.5], [10.2, 3.3], [-4.0, 99.0]])
    np.testing.assert_allclose(grid.to_grid(grid.to_map(cells)), cells, atol=1e-9)
    np.testing.assert_allclose(grid.to_map([0.0, 0.0]), [x, y], atol=1e-12)


@given(yaw=st.one_of(st.floats(-7, 7), st.sampled_from([-0.0, *(k * np.pi / 4 for k in range(-8, 9))])))
def test_who_receives_a_turned_map_finds_the_version_that_was_announced(yaw: float) -> None:
    """Of one in five yaws, and of -0.0, it was another one, and no projector ever had the map."""
    grid = some_map((1.5, -2.25, yaw))
    message = to_message(grid, "map")
    received = from_message(type(message).FromString(message.SerializeToString()))
    assert received.version == grid.version
    assert np.allclose(received.to_map([3.0, 4.0]), grid.to_map([3.0, 4.0]))


def test_numbers_with_an_exponent_alone_are_numbers(tmp_path: Path) -> None:
    """YAML 1.1 takes 1e-17 for a text."""
    grid = read_map(saved(tmp_path, PIXELS, resolution="5e-2", origin="[-1, 2, 1e-17]"))
    assert grid.resolution == 0.05
    assert grid.origin.tolist() == [-1.0, 2.0, 1e-17]


@pytest.mark.parametrize(
    ("grid", "words"),
    [
        (np.zeros((3, 3), np.uint8), "ndarray is no GridMap"),
        (GridMap(np.zeros((3, 3)), 0.05, np.zeros(3)), "cells: float64"),  # type: ignore[arg-type]
        (GridMap([[0]], 0.05, np.zeros(3)), "cells: list"),  # type: ignore[arg-type]
        (GridMap(np.zeros((0, 3), np.uint8), 0.05, np.zeros(3)), "of shape"),
        (GridMap(np.full((3, 3), 87, np.uint8), 0.05, np.zeros(3)), "cells: hold 87"),
        (GridMap(np.zeros((3, 3), np.uint8), 0.0, np.zeros(3)), "resolution = 0.0"),
        (GridMap(np.zeros((3, 3), np.uint8), "0.05", np.zeros(3)), "resolution = '0.05'"),  # type: ignore[arg-type]
        (GridMap(np.zeros((3, 3), np.uint8), 0.05, np.zeros(2)), "origin = "),
        (GridMap(np.zeros((3, 3), np.uint8), 0.05, np.full(3, np.nan)), "origin = "),
    ],
)
def test_what_is_no_grid_is_named(grid: object, words: str) -> None:
    with pytest.raises(MapError, match=words):
        check_grid(grid)


def test_cells_are_found_in_a_turned_map_and_unknown_is_outside() -> None:
    grid = some_map()
    for row, column in [(0, 0), (6, 10), (3, 4)]:
        assert grid.at(grid.to_map([column + 0.4, row + 0.6])) == grid.cells[row, column]
    outside = grid.to_map([[-0.1, 2.0], [2.0, 7.1], [11.1, 2.0], [1e6, 1e6]])
    assert (grid.at(outside) == UNKNOWN).all()
    free = np.count_nonzero(grid.cells == FREE)
    assert grid.free_area == pytest.approx(free * 0.0025)


def test_the_version_is_the_contents() -> None:
    grid = some_map()
    other = grid.cells.copy()
    other[3, 3] = FREE if other[3, 3] != FREE else OCCUPIED
    versions = {
        grid.version,
        GridMap(other, 0.05, grid.origin).version,
        GridMap(grid.cells, 0.06, grid.origin).version,
        GridMap(grid.cells, 0.05, grid.origin + 1e-9).version,
        GridMap(grid.cells.reshape(11, 7), 0.05, grid.origin).version,
    }
    assert len(versions) == 5


def _yaml(folder: Path, **fields: Any) -> Path:
    return saved(folder, PIXELS, "map.pgm", **fields)


@pytest.mark.parametrize(
    "fields",
    [{"resolution": 1e-9}, {"origin": "[1.0e+308, 0, 0]"}, {"origin": "[0, .inf, 0]"}],
)
def test_numbers_that_no_building_has(tmp_path: Path, fields: dict[str, Any]) -> None:
    with pytest.raises(MapError, match=next(iter(fields))):
        read_map(_yaml(tmp_path, **fields))


def test_a_yaml_that_grows_when_it_is_read_is_refused(tmp_path: Path) -> None:
    path = _yaml(tmp_path)
    lines = ["a: &a0 [x, x]", *(f"b{n}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]" for n in range(9))]
    path.write_text(path.read_text() + "\n" + "\n".join(lines) + "\n")
    with pytest.raises(MapError, match="alias") as error:
        read_map(path)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize("which", ["map.yaml", "map.pgm"])
def test_a_pipe_is_not_waited_for(tmp_path: Path, which: str) -> None:
    path = _yaml(tmp_path)
    (tmp_path / which).unlink()
    os.mkfifo(tmp_path / which)
    with pytest.raises(MapError, match="no file"):
        read_map(path)


def test_an_image_that_would_start_a_program_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, program = _yaml(tmp_path), tmp_path / "gs"
    program.write_text(f"#!/bin/sh\ntouch {tmp_path}/started\n")
    program.chmod(0o755)
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", str(program))  # Pillow looks for it once only
    (tmp_path / "map.pgm").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n%%EOF\n")
    with pytest.raises(MapError, match="cannot be read"):
        read_map(path)
    assert not (tmp_path / "started").exists()


@given(
    st.sampled_from(["resolution", "x", "y"]), st.sampled_from([1e308, -1e308, 1e300, float("nan"), 1e-300])
)
def test_a_grid_from_the_network_lies_where_a_building_can(field: str, value: float) -> None:
    message = to_message(GridMap(np.zeros((2, 2), np.uint8), 0.05, np.zeros(3)), "map")
    if field == "resolution":
        message.cell_size.x = message.cell_size.y = value
    else:
        setattr(message.pose.position, field, value)
    if field == "resolution" or not abs(value) < 1.0:
        with pytest.raises(MapError):
            from_message(message)


@pytest.mark.parametrize("yaw", [90.0, -180.0])
def test_a_yaw_in_degrees_is_refused(tmp_path: Path, yaw: float) -> None:
    path = tmp_path / "map.yaml"
    grid = GridMap(np.array([[FREE, OCCUPIED]], dtype=np.uint8), 0.05, np.array([0.0, 0.0, yaw]))
    write_map(grid, path)
    with pytest.raises(MapError, match=r"map.yaml: origin = .*radians"):
        read_map(path)
    with pytest.raises(MapError, match="origin = "):
        check_grid(grid)
