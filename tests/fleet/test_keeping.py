"""As shipped, a site keeps its map true: in the containers, in a fleet's containers, and under systemd."""

import math
from pathlib import Path

import pytest
import yaml
from eigenscan.fleet.layout import begin, checked, read
from eigenscan.mapbuilder.options import MapbuilderOptions
from eigenscan.runtime.settings import load
from eigenscan.schemas.channels import SCAN

from tests.environment import ROOT
from tests.fleet.conftest import run


@pytest.mark.parametrize("file", ["docker-compose.yml", "deploy/fleet.yml"])
def test_the_containers_build_into_a_volume_of_their_own(file: str) -> None:
    stack = yaml.safe_load((ROOT / file).read_text())
    mapbuilder = stack["services"]["mapbuilder"]
    model = Path(mapbuilder["environment"]["EIGENSCAN_MAPBUILDER_MODEL"])
    assert "EIGENSCAN_MAPBUILDER_CHANGES" not in mapbuilder["environment"]
    assert f"models:{model.parent}" in mapbuilder["volumes"]
    assert "models" in stack["volumes"]
    assert str(model.parent) in (ROOT / "Dockerfile").read_text()  # owned by the services' user


def test_a_fleets_site_keeps_its_map_and_receives_two_scans_a_second(tmp_path: Path) -> None:
    certified = run(
        "certify", "--site", "s", "--address", "localhost", "--robot", "r17", "-o", tmp_path / "f"
    )
    assert certified.exit_code == 0, certified.stderr
    config = tmp_path / "f/site/eigenscan.toml"
    options = load(MapbuilderOptions, "mapbuilder", ["--config", str(config)])
    assert options.map is not None
    assert options.model is not None
    assert options.changes is None  # propose, where the folder can be written
    assert read(tmp_path / "f").air_of("r17")[SCAN.name] == 2.0


def test_who_is_answered_by_a_projector_elsewhere_sends_all_its_scans(tmp_path: Path) -> None:
    begin(tmp_path, "s", ["localhost"])
    published = read(tmp_path).model_dump() | {"groups": {"lab": "a-*"}, "robots": {"a-2": {"scan": 5.0}}}
    fleet = checked(published, "here")
    assert fleet.air_of("a-1")[SCAN.name] == math.inf
    assert fleet.air_of("a-2")[SCAN.name] == 5.0
    assert fleet.air_of("b-1")[SCAN.name] == 2.0
