"""The words of `eigenscan-together`: names, and the arguments of each."""

import pytest
from eigenscan.cli.launch.supervision import NODES
from eigenscan.cli.launch.together import groups, service
from eigenscan.runtime.settings import SettingsError


def test_without_a_name_it_is_all_that_a_robot_needs() -> None:
    assert groups(["--robot", "r17"]) == [(["scan-ingest", "projector", "tracker"], ["--robot", "r17"])]


def test_groups_are_distinguished_and_brought_into_the_order_of_the_pipeline() -> None:
    words = ["recorder", "--mcap", "out", "--", "tracker,projector", "--site", "s"]
    assert groups(words) == [(["tracker", "projector"], ["--site", "s"]), (["recorder"], ["--mcap", "out"])]


def test_an_unknown_name_is_reported() -> None:
    with pytest.raises(SettingsError, match="'traker'; choose one of scan-ingest"):
        groups(["traker"])


@pytest.mark.parametrize("name", NODES)
def test_every_service_can_be_hosted(name: str) -> None:
    assert service(name).name == name
