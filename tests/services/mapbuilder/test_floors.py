"""A mapbuilder with one map leaves the models of several floors alone."""

from pathlib import Path

import pytest
from eigenscan.cli.main import app
from eigenscan.eigenspace.folder import read_models
from eigenscan.geometry.gridmap import MapError, write_map
from eigenscan.mapbuilder.floors import stack
from eigenscan.mapbuilder.node import make_core
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.runtime.settings import SettingsError
from eigenscan.workbench.simulation.world import office
from typer.testing import CliRunner


def test_a_map_beside_a_folder_of_several_floors_is_refused(tmp_path: Path) -> None:
    """Its models replaced those of the second floor, with health OK."""
    maps = [tmp_path / f"{name}.yaml" for name in ("ground", "first")]
    for path in maps:
        write_map(office().render(), path)
    model = tmp_path / "model"
    done = CliRunner().invoke(app, ["build", *map(str, maps), "-o", str(model), "--step", "4"])
    assert done.exit_code == 0, done.output
    with pytest.raises(SettingsError, match="holds the floors ground, first") as refused:
        make_core(MapbuilderOptions(map=maps[0], model=model))
    for words in (str(maps[0]), str(model), "remove map from the settings"):
        assert words in str(refused.value)
    make_core(MapbuilderOptions(model=model))
    assert len(read_models(model).floors) == 2


@pytest.mark.parametrize("name", ["a\0b", "a\nb", "a?b", "x" * 65, ""])
def test_a_name_that_no_region_can_have_is_refused(name: str) -> None:
    with pytest.raises(MapError, match="cannot be a floor's name"):
        stack([("ground", office().render()), (name, office().render())])


def test_floors_that_together_nobody_could_read_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = office().render()
    monkeypatch.setattr("eigenscan.mapbuilder.floors.MOST_CELLS", 2 * grid.cells.size)
    with pytest.raises(MapError, match=r"ground, first: \d+ x \d+ cells together"):
        stack([("ground", grid), ("first", grid)])
