import io
from dataclasses import replace

import numpy as np
import pytest
from eigenscan.eigenspace.components import analyse
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import NO_WALL, ModelError, RegionModel
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap, read_map
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.backdrop import Backdrop
from eigenscan.mapbuilder.core import MapbuilderCore
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.mapbuilder.picture import _colour, draw_regions
from eigenscan.mapbuilder.positions import free_positions
from eigenscan.mapbuilder.settings import MapbuilderSettings
from eigenscan.mapbuilder.shards import shards
from eigenscan.mapbuilder.site import Plan, build_site, lay_out
from eigenscan.schemas import model_pb2
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.health_pb2 import Health
from eigenscan.schemas.loopback import Loopback
from foxglove_schemas_protobuf.Grid_pb2 import Grid
from PIL import Image, ImageDraw
from pydantic import ValidationError

from tests.environment import DATASETS

QUICK = Plan(step=TURN / 180)


def test_a_models_panoramas_are_what_is_seen_from_its_positions(office: GridMap) -> None:
    site = build_site(office, QUICK)
    caster = RayCaster.of(office)
    for model in site.regions:
        poses = np.column_stack([model.positions, np.zeros(len(model.positions))])
        cast = caster.cast(poses, np.arange(180) * (TURN / 180), QUICK.range_max)
        difference = np.where(model.panoramas == cast, 0.0, model.panoramas - cast)
        assert (np.abs(difference) <= 0.0011).mean() > 0.999


def test_a_models_eigenspace_is_that_of_its_panoramas(office: GridMap) -> None:
    plan = replace(QUICK, embedding="range", range_cap=7.0, components=5, field_of_view=np.deg2rad(120))
    for model in build_site(office, plan).regions:
        space = analyse(np.minimum(model.panoramas, 7.0)[None], 61, 5)
        np.testing.assert_array_equal(model.space.space.vectors, space.vectors)
        np.testing.assert_array_equal(model.space.space.eigenvalues, space.eigenvalues)


def test_the_same_map_gives_the_same_site_on_any_number_of_threads(office: GridMap) -> None:
    versions = {build_site(office, replace(QUICK, threads=n)).to_message().version for n in (1, 1, 3)}
    assert len(versions) == 1


def test_a_site_that_is_cast_in_shards_is_the_same(office: GridMap, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = build_site(office, QUICK).to_message()
    monkeypatch.setattr("eigenscan.mapbuilder.site.shards", lambda areas: shards(areas, 60))
    assert build_site(office, QUICK).to_message() == whole


def test_a_change_at_one_end_leaves_the_models_that_do_not_see_it(office: GridMap) -> None:
    before = {m.region: m.version for m in build_site(office, QUICK).regions}
    cells = office.cells.copy()
    cells[100:110, 215:225] = OCCUPIED  # a cabinet in the right room, away from its door
    after = {m.region: m.version for m in build_site(replace(office, cells=cells), QUICK).regions}
    assert before.keys() == after.keys()
    changed = {name for name in before if before[name] != after[name]}
    assert "r02" not in changed
    assert "r03" in changed


def test_progress_goes_from_nothing_to_all(office: GridMap) -> None:
    received = []
    build_site(office, QUICK, lambda what, share: received.append((what, share)))
    shares = [share for _, share in received]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert next(what for what, _ in received) == "regions"


@pytest.mark.parametrize("value", [UNKNOWN, OCCUPIED])
def test_a_map_without_free_space_is_refused(value: int) -> None:
    grid = GridMap(np.full((30, 30), value, np.uint8), 0.05, np.zeros(3))
    with pytest.raises(ModelError, match="no free position"):
        build_site(grid, QUICK)


def test_a_field_without_walls_is_a_model_that_sees_none() -> None:
    grid = GridMap(np.full((80, 80), FREE, np.uint8), 0.05, np.zeros(3))
    site = build_site(grid, QUICK)
    assert all((model.ranges == NO_WALL).all() for model in site.regions)
    for model in site.regions:
        RegionModel.from_message(model.to_message())


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-103.37, 55.01, 0.0), (12.0, -9.0, 2.5), (0, 0, -9.0)])
def test_where_a_maps_origin_lies_does_not_matter(
    office: GridMap, origin: tuple[float, float, float]
) -> None:
    grid = replace(office, origin=np.array(origin, dtype=float))
    site = build_site(grid, QUICK)
    assert len(site.regions) == 3
    count = sum(len(model.index) for model in site.regions)
    assert count == pytest.approx(sum(len(m.index) for m in build_site(office, QUICK).regions), rel=0.15)
    for model in site.regions:
        assert (grid.at(model.positions) == FREE).all()


def test_the_picture_shows_each_region_in_its_own_colour(office: GridMap) -> None:
    with Image.open(io.BytesIO(draw_regions(office, lay_out(office, QUICK).areas))) as image:
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(int)
    coloured = pixels[pixels.max(axis=1) - pixels.min(axis=1) > 25]
    hues = {tuple(p) for p in (coloured // 24).tolist()}
    assert len(coloured) > 0.2 * len(pixels)
    assert len(hues) >= 3


def test_a_region_under_others_keeps_its_outline_in_the_picture(office: GridMap) -> None:
    """Of one of 24 m2 a strip was to be seen."""
    areas = lay_out(office, QUICK).areas
    with Image.open(io.BytesIO(draw_regions(office, areas))) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    colours = np.array([_colour(number) for number in range(len(areas))])
    corners = np.round([at for area in areas for at in Backdrop(office).pixels(area.outline)]).astype(int)
    seen = pixels[corners[:, 1], corners[:, 0]]
    drawn = np.abs(seen[:, None] - colours).max(axis=-1).min(axis=1) < 10
    assert drawn.mean() > 0.95


def test_names_lie_beside_each_other_in_the_picture(office: GridMap, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a site of 1,341 regions nothing else was to be seen. Where they fit, all are drawn."""
    areas, drawn = lay_out(office, QUICK).areas, list[str]()

    def write(_: object, _place: object, text: str, *_style: object, **_more: object) -> None:
        drawn.append(text.partition("\n")[0])

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", write)
    under = [replace(area, name=f"{area.name}b") for area in areas]
    draw_regions(office, [*areas, *under])
    names = {area.name for area in areas}
    assert [name for name in drawn if name in names | {area.name for area in under}] == [
        area.name for area in sorted(areas, key=lambda one: -one.size)
    ]


def published(core: MapbuilderCore) -> list[Envelope]:
    return list(Loopback([core]).start())


def test_the_core_publishes_the_map_then_the_models_then_their_set(office: GridMap) -> None:
    core = MapbuilderCore(MapbuilderSettings(step=2.0), office, site="lab")
    assert core.condition().status == Health.STATUS_WAITING
    envelopes = published(core)
    assert [e.channel.name for e in envelopes] == ["map", "model", "model", "model", "model_set"]
    assert [e.key for e in envelopes[:2]] == ["lab/map", "lab/model/r01"]
    models = [RegionModel.from_message(e.open(model_pb2.RegionModel)) for e in envelopes[1:4]]
    message = envelopes[4].open(model_pb2.ModelSet)
    assert [entry.version for entry in message.entries] == [model.version for model in models]
    assert message.map_version == office.version
    assert core.condition().status == Health.STATUS_OK
    assert core.condition().counters["regions"] == 3
    assert list(core.finish()) == []


def test_models_that_were_built_before_are_published_as_they_are(office: GridMap) -> None:
    site = build_site(office, replace(QUICK, frame_id="floor2"))
    core = MapbuilderCore(MapbuilderSettings(), site)
    envelopes = published(core)
    assert envelopes[0].open(Grid).frame_id == "floor2"
    assert envelopes[-1].message == site.to_message()


def test_the_settings_ask_for_one_source_and_name_what_is_out_of_range() -> None:
    with pytest.raises(ValidationError, match=r"give map .*, model .*, or both"):
        MapbuilderOptions()
    with pytest.raises(ValidationError, match="spacing"):
        MapbuilderOptions(map="a", spacing=0.0)
    assert MapbuilderOptions(map="a", step=1.0, threads=2).plan == Plan(step=np.deg2rad(1.0), threads=2)


@pytest.mark.dataset
@pytest.mark.parametrize("name", ["fr079", "intel", "jarvis", "guardian", "olin_mac"])
def test_real_buildings_travel_small_and_come_back_whole(name: str) -> None:
    grid = read_map(DATASETS / name / "map.yaml")
    site = build_site(grid, Plan(threads=2))
    assert isinstance(site, SiteModel)
    sizes = [entry.size for entry in site.to_message().entries]
    # 20 MB for 700 m2 at 0.25 m, so a quarter of that at 0.5 m
    assert sum(sizes) < 20e6 * (grid.free_area / 700) / 4
    for model in site.regions[:3]:
        assert RegionModel.from_message(model.to_message()).version == model.version
        assert 0.5 < model.space.space.explained < 1.0


@pytest.mark.parametrize("shape", [(1, 1), (1, 200), (200, 1), (2, 2)])
def test_a_map_too_narrow_for_a_region_is_refused(shape: tuple[int, int]) -> None:
    with pytest.raises(ModelError, match="too narrow"):
        lay_out(GridMap(np.full(shape, FREE, dtype=np.uint8), 0.05, np.zeros(3)), QUICK)


def test_a_region_that_nobody_could_read_is_refused_before_it_is_built(
    office: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eigenscan.mapbuilder.site.MOST_BYTES", 2 * 180 * 40)
    with pytest.raises(ModelError, match=r"region 'r\d+' has \d+ positions of 180 beams.*coarser spacing"):
        lay_out(office, QUICK)


def test_positions_do_not_depend_on_how_many_are_looked_up_at_a_time(
    office: GridMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = free_positions(office, 0.1, 0.15)
    monkeypatch.setattr("eigenscan.mapbuilder.positions.AT_ONCE", 1000)
    parts = free_positions(office, 0.1, 0.15)
    np.testing.assert_array_equal(parts.index, whole.index)
    assert parts.index.dtype == whole.index.dtype
