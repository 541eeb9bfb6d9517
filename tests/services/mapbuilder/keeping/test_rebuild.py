from dataclasses import replace

import numpy as np
import pytest
from eigenscan.eigenspace.folder import SiteModel
from eigenscan.eigenspace.model import RegionModel
from eigenscan.geometry.circle import TURN
from eigenscan.geometry.gridmap import OCCUPIED, GridMap
from eigenscan.mapbuilder.keeping.rebuild import rebuild
from eigenscan.mapbuilder.site import Plan, build_site

from tests.services.mapbuilder.floorplan import box

PLAN = Plan(step=TURN / 180)
CABINET = (10.0, 4.4, 11.6, 5.6)
"""In the right room of the office, away from its door; other rooms do not see it."""


@pytest.fixture
def furnished(office: GridMap) -> GridMap:
    after = replace(office, cells=office.cells.copy())
    box(after, *CABINET, OCCUPIED)
    return after


def table(model: RegionModel) -> dict[tuple[int, ...], list[int]]:
    """Each position's panorama."""
    return {tuple(at): row for at, row in zip(model.index.tolist(), model.ranges.tolist(), strict=True)}


def everything(site: SiteModel) -> dict[tuple[int, ...], list[int]]:
    """The panoramas of all regions."""
    return {at: row for model in site.regions for at, row in table(model).items()}


def test_only_regions_that_see_the_change_are_made_again(office: GridMap, furnished: GridMap) -> None:
    before = build_site(office, PLAN)
    after = rebuild(before, furnished, PLAN)
    assert [m.region for m in after.regions] == [m.region for m in before.regions]
    same = [a is b for a, b in zip(after.regions, before.regions, strict=True)]
    assert any(same)
    assert not all(same)
    assert after.grid is furnished


@pytest.mark.parametrize("gone", [False, True])
def test_what_is_made_again_is_what_a_whole_build_sees(
    office: GridMap, furnished: GridMap, gone: bool
) -> None:
    old, new = (furnished, office) if gone else (office, furnished)
    after, whole = rebuild(build_site(old, PLAN), new, PLAN), build_site(new, PLAN)
    assert everything(after) == everything(whole)
    for model in after.regions:
        space = model.derive(PLAN.analysis)[0]
        np.testing.assert_array_equal(model.space.space.vectors, space.space.vectors)
        np.testing.assert_array_equal(model.index, model.index[np.lexsort(model.index.T)])


def test_there_and_back_again_is_the_same_map_and_the_same_panoramas(
    office: GridMap, furnished: GridMap
) -> None:
    before = build_site(office, PLAN)
    back = rebuild(rebuild(before, furnished, PLAN), office, PLAN)
    assert back.grid.version == before.grid.version
    for one, other in zip(before.regions, back.regions, strict=True):
        assert set(table(one)) - set(table(other)) == set()
    assert everything(back) == everything(before)


def test_a_model_that_was_built_otherwise_keeps_what_it_did_not_lose(
    office: GridMap, furnished: GridMap
) -> None:
    """Of another reach than the service's plan: where nothing changed, its panoramas stay as they are."""
    before = build_site(office, replace(PLAN, range_max=3.0))
    after = rebuild(before, furnished, PLAN)
    untouched = [a for a, b in zip(after.regions, before.regions, strict=True) if a is b]
    assert untouched
    assert all(a is b for a, b in zip(rebuild(before, office, PLAN).regions, before.regions, strict=True))
