"""Maps as users have them, good and bad, through `eigenscan build` itself."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from eigenscan.eigenspace.folder import SiteModel, read_models
from eigenscan.geometry.gridmap import FREE, OCCUPIED, GridMap
from eigenscan.geometry.raycast import RayCaster
from PIL import Image

from tests.command import eigenscan
from tests.services.mapbuilder.floorplan import two_rooms

ORIGIN = (0.0, 0.0, 0.0)


def build(yaml: Path, out: Path) -> subprocess.CompletedProcess[str]:
    return eigenscan("build", yaml, "-o", out, "--step", 2)


def save(
    folder: Path,
    pixels: np.ndarray,
    origin: tuple[float, float, float] = ORIGIN,
    resolution: float = 0.05,
    image: str = "map.png",
    **meta: object,
) -> Path:
    """A map_server pair; `pixels` by rows from below."""
    Image.fromarray(np.ascontiguousarray(pixels[::-1])).save(folder / image)
    fields = {"image": image, "resolution": resolution, "origin": list(origin), "negate": 0}
    fields |= {"occupied_thresh": 0.65, "free_thresh": 0.196} | meta
    path = folder / "map.yaml"
    path.write_text("".join(f"{name}: {value}\n" for name, value in fields.items()))
    return path


def grey(cells: np.ndarray, free: int = 254, occupied: int = 0, unknown: int = 205) -> np.ndarray:
    return np.select([cells == FREE, cells == OCCUPIED], [free, occupied], unknown).astype(np.uint8)


def built(yaml: Path, folder: Path) -> SiteModel:
    done = build(yaml, folder / "model")
    assert done.returncode == 0, done.stderr
    return read_models(folder / "model")


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[GridMap, SiteModel]:
    """The office as most maps are: trinary, not negated, at the origin."""
    grid = two_rooms()
    folder = tmp_path_factory.mktemp("usual")
    return grid, built(save(folder, grey(grid.cells)), folder)


@pytest.mark.parametrize("how", ["negated", "scale", "transparent", "raw"])
def test_however_it_is_saved_it_is_the_same_map(
    usual: tuple[GridMap, SiteModel], tmp_path: Path, how: str
) -> None:
    grid, expected = usual
    cells, meta = grid.cells, dict[str, Any]()
    if how == "negated":
        pixels, meta = grey(cells, 0, 255, 128), {"negate": 1}
    elif how == "scale":
        pixels, meta = grey(cells, 255, 0, 128), {"mode": "scale"}
    elif how == "transparent":
        seen = grey(cells, 255, 0, 255)
        pixels, meta = np.dstack([seen] * 3 + [np.where(cells == 255, 0, 255)]), {"mode": "scale"}
        pixels = pixels.astype(np.uint8)
    else:
        pixels, meta = grey(cells, 0, 100, 255), {"mode": "raw"}
    site = built(save(tmp_path, pixels, **meta), tmp_path)
    np.testing.assert_array_equal(site.grid.cells, cells)
    assert site.to_message() == expected.to_message()


@pytest.mark.parametrize("origin", [(-103.37, 55.011, 0.0), (7.3, -2.0, 2.5), (1e4, 1e4, -0.01)])
def test_wherever_its_origin_lies_the_panoramas_are_what_is_seen_there(
    usual: tuple[GridMap, SiteModel], tmp_path: Path, origin: tuple[float, float, float]
) -> None:
    grid, _ = usual
    site = built(save(tmp_path, grey(grid.cells), origin=origin), tmp_path)
    assert site.grid.origin.tolist() == list(origin)
    assert len(site.regions) == 3
    caster = RayCaster.of(site.grid)
    for model in site.regions:
        assert (site.grid.at(model.positions) == FREE).all()
        poses = np.column_stack([model.positions, np.zeros(len(model.positions))])
        seen = caster.cast(poses, np.arange(180) * (2 * np.pi / 180), 80.0)
        assert np.mean(np.isclose(model.panoramas, seen, atol=0.0015)) > 0.999


def test_walls_of_one_pixel_hold_every_ray(tmp_path: Path) -> None:
    # a slanted room: one pixel a row or column, so that walls hang together by their corners only
    row, column = np.mgrid[:160, :160]
    away = np.abs(row - 80) + np.abs(column - 80)
    cells = np.select([away < 70, away == 70], [FREE, OCCUPIED], 255).astype(np.uint8)
    (model,) = built(save(tmp_path, grey(cells)), tmp_path).regions
    assert np.isfinite(model.panoramas).all()
    assert model.panoramas.max() <= 140 * 0.05


@pytest.mark.slow
@pytest.mark.parametrize(("image", "is_reported"), [("map.jpg", True), ("map.png", False)])
def test_the_noise_of_a_jpeg_is_reported(tmp_path: Path, image: str, is_reported: bool) -> None:
    """It makes the savers' grey for unknown free here and there: 28 % more free ground in one map."""
    result = build(save(tmp_path, grey(two_rooms().cells), image=image), tmp_path / "model")
    assert result.returncode == 0, result.stderr
    assert ("map.yaml: its image is a JPEG" in result.stderr) == is_reported


def test_huge_unknown_areas_change_nothing(usual: tuple[GridMap, SiteModel], tmp_path: Path) -> None:
    grid, expected = usual
    cells = np.full((3200, 3600), 255, dtype=np.uint8)
    height, width = grid.cells.shape
    cells[2000 : 2000 + height, 1200 : 1200 + width] = grid.cells
    site = built(save(tmp_path, grey(cells), origin=(-60.0, -100.0, 0.0)), tmp_path)
    assert [m.region for m in site.regions] == [m.region for m in expected.regions]
    for model, other in zip(site.regions, expected.regions, strict=True):
        np.testing.assert_array_equal(model.index, other.index)
        assert np.mean(model.ranges == other.ranges) > 0.999


@pytest.mark.parametrize(
    ("cells", "meta", "stated"),
    [
        (np.full((90, 90), 255), {}, "no free cell in {}/map.png: check negate, free_thresh"),
        (np.full((90, 90), OCCUPIED), {}, "no free cell"),
        (np.where(np.arange(8100).reshape(90, 90) % 3, OCCUPIED, FREE), {}, "no free position 0.15 m"),
        ("office", {"negate": "maybe"}, "negate = 'maybe': give 0 or 1"),
        ("office", {"free_thresh": 0.7}, "free_thresh = 0.7 is above occupied_thresh = 0.65: swap"),
        ("deep", {}, "has more than 8 bits a pixel: save it with 8"),
    ],
)
def test_what_is_wrong_is_reported_in_one_line_with_the_fix(
    office: GridMap, tmp_path: Path, cells: np.ndarray | str, meta: dict[str, Any], stated: str
) -> None:
    if isinstance(cells, str):
        pixels = grey(office.cells).astype(np.uint16 if cells == "deep" else np.uint8)
    else:
        pixels = grey(cells)
    yaml = save(tmp_path, pixels, **meta)
    done = build(yaml, tmp_path / "model")
    assert done.returncode == 2, done.stdout
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith(f"eigenscan build: {yaml}")
    assert stated.format(tmp_path) in line
    assert not (tmp_path / "model").exists()
    assert not (tmp_path / "model.pieces").exists()
