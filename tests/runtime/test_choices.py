"""Settings of several services at once: what wins, and what is reported of a mistake."""

from __future__ import annotations

from pathlib import Path

import pytest
from eigenscan.projector.options import ProjectorOptions
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.runtime.choices import Choices
from eigenscan.runtime.settings import SettingsError, load
from eigenscan.schemas.methods import METHODS
from eigenscan.tracker.options import TrackerOptions
from eigenscan.tracker.settings import TrackerSettings

SERVICES = ("projector", "tracker")


def tracker(choices: Choices) -> TrackerSettings:
    return choices.core(TrackerOptions, TrackerSettings, "tracker")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "site.toml"
    path.write_text(
        'site = "hospital"\n[tracker]\nlocalized_above = 0.8\ntrust = 0.7\nlast_pose_age = 5.0\n'
        '[projector]\ninterpolation = "enclosing"\n'
    )
    return path


def test_a_change_wins_over_the_file_and_the_file_over_the_method(file: Path) -> None:
    chosen = Choices.of("paper", file, ["tracker.trust=0.5"], SERVICES)
    settings = tracker(chosen)
    assert (settings.method, settings.localized_above, settings.trust) == ("paper", 0.8, 0.5)
    projector = chosen.core(ProjectorOptions, ProjectorSettings, "projector")
    assert (projector.interpolation, projector.association) == ("enclosing", "tetrahedra")


def test_a_process_receives_the_same(file: Path) -> None:
    for chosen in (
        Choices.of("paper", file, ["projector.candidates=70", "tracker.trust=0.5"], SERVICES),
        Choices.of("paper", None, ["projector.focus=true"], SERVICES),
        Choices.of("default", None, [], SERVICES),
    ):
        options = load(TrackerOptions, "tracker", chosen.flags(TrackerOptions, "tracker"))
        assert {name: getattr(options, name) for name in TrackerSettings.model_fields} == dict(
            tracker(chosen)
        )
        reported = load(ProjectorOptions, "projector", chosen.flags(ProjectorOptions, "projector"))
        expected = chosen.core(ProjectorOptions, ProjectorSettings, "projector")
        assert {name: getattr(reported, name) for name in ProjectorSettings.model_fields} == dict(expected)
    assert Choices().flags(TrackerOptions, "tracker") == []


@pytest.mark.parametrize(
    ("changes", "stated"),
    [
        (["localized_above=0.9"], "--set localized_above=0.9: give SERVICE.SETTING=VALUE"),
        (["tracker.trust"], "--set tracker.trust: give SERVICE.SETTING=VALUE"),
        (["trakcer.trust=1"], "--set trakcer.trust=1: trakcer: unknown, did you mean tracker?"),
        (["recorder.mcap=x"], "recorder: unknown: choose one of projector, tracker"),
        (["tracker.localised_above=0.9"], "tracker.localised_above: unknown, did you mean localized_above?"),
        (["tracker.localized_above=2"], "--set tracker.localized_above = '2': must be less"),
        (["tracker.method=papre"], "--set tracker.method = 'papre': must be 'mixture' or 'paper'"),
        (["projector.components=8"], "--set projector.components: was removed"),
        (["tracker.last_pose=here"], "--set tracker.last_pose: unknown"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_fix(changes: list[str], stated: str) -> None:

    def choose() -> None:
        choices = Choices.of("default", None, changes, SERVICES)
        tracker(choices)
        choices.core(ProjectorOptions, ProjectorSettings, "projector")

    with pytest.raises(SettingsError) as reported:
        choose()
    assert stated in str(reported.value)


def test_a_mistake_in_the_file_is_named(file: Path, tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="--method papyrus: unknown: choose one of default, paper"):
        Choices.of("papyrus", None, [], SERVICES)
    file.write_text("[tracker]\ntrst = 1\n")
    with pytest.raises(SettingsError, match=r"site.toml: \[tracker\] trst: unknown, did you mean trust\?"):
        tracker(Choices.of("default", file, [], SERVICES))
    with pytest.raises(SettingsError, match="check --settings"):
        tracker(Choices.of("default", tmp_path / "none.toml", [], SERVICES))


def test_the_environment_is_no_part_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EIGENSCAN_TRACKER_TRUST", "0.3")
    assert tracker(Choices()).trust == 1.0


def test_every_method_is_of_settings_that_there_are() -> None:
    from eigenscan.workbench.evaluation.chosen import SERVICES as EVALUATED
    from eigenscan.workbench.evaluation.chosen import PipelineSettings, chosen

    for method, table in METHODS.items():
        assert set(table) <= set(EVALUATED)
        chosen(Choices.of(method, None, [], EVALUATED))
    assert chosen(Choices()) == PipelineSettings()
    assert chosen(Choices.of("paper", None, [], EVALUATED)).mapbuilder.spacing == 0.5
    assert chosen(Choices.of("paper", None, [], EVALUATED), spacing=0.3).mapbuilder.spacing == 0.3
    assert chosen(Choices.of("default", None, ["mapbuilder.spacing=1"], EVALUATED)).mapbuilder.spacing == 1.0


def test_a_value_may_begin_with_a_dash() -> None:
    chosen = Choices.of("default", None, ["tracker.instance=-1e-3"], SERVICES)
    assert load(TrackerOptions, "tracker", chosen.flags(TrackerOptions, "tracker")).instance == "-1e-3"
