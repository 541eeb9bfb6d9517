"""The ROS package: what colcon reads of it, and which command its launch file starts.

`launch` is no package of the registries, so a stub stands in for its four classes.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
import typer
import yaml
from eigenscan.cli.main import app
from eigenscan.cli.run import _flags

from tests.environment import ROOT

PACKAGE = ROOT / "deploy/ros2/eigenscan_bringup"
LAUNCH = PACKAGE / "launch/localization_launch.py"
NAV2_ARGUMENTS = {
    "namespace", "map", "use_sim_time", "params_file", "autostart", "use_composition",
    "use_intra_process_comms", "container_name", "use_respawn", "log_level",
}  # fmt: skip
"""Of nav2_bringup's localization_launch.py: what a launch file that includes it may give."""
AMCL = {
    "alpha1": 0.2,
    "base_frame_id": "base_footprint",
    "odom_frame_id": "wheels",
    "global_frame_id": "site",
    "tf_broadcast": False,
    "scan_topic": "front/scan",
    "transform_tolerance": 1.0,
    "set_initial_pose": True,
    "initial_pose": {"x": 2.0, "y": -1.5, "z": 0.0, "yaw": 0.7},
}


def nested(names: list[str], parameters: dict[str, Any]) -> dict[str, Any]:
    """A parameter file with the parameters of one node, under its names from the outermost."""
    content: dict[str, Any] = {"ros__parameters": parameters}
    for name in reversed(names):
        content = {name: content}
    return content | {"map_server": {"ros__parameters": {"yaml_filename": ""}}}


class Argument(SimpleNamespace):
    """Of a launch file."""

    def __init__(self, name: str, *, default_value: str, description: str) -> None:
        super().__init__(name=name, default=default_value, about=description)


class Configuration:
    """One argument's value."""

    def __init__(self, name: str) -> None:
        self._name = name

    def perform(self, context: dict[str, str]) -> str:
        return context[self._name]


@pytest.fixture
def launch_file(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the launch file defines."""
    stub: dict[str, dict[str, Any]] = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": Argument,
            "ExecuteProcess": SimpleNamespace,
            "OpaqueFunction": SimpleNamespace,
        },
        "launch.substitutions": {"LaunchConfiguration": Configuration},
    }
    for name, content in stub.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return runpy.run_path(str(LAUNCH))


def started(launch_file: dict[str, Any], **given: str) -> Any:
    """The process that it starts."""
    *arguments, function = launch_file["generate_launch_description"]()
    (process,) = function.function({each.name: each.default for each in arguments} | given)
    return process


def read(command: list[str]) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """The options of `eigenscan run`, and the flags of each service; fails where the command line is none."""
    program, name, *words = command
    assert program == "eigenscan"
    group = typer.main.get_command(app)
    chosen = group.get_command(None, name)  # type: ignore[attr-defined]
    options = chosen.make_context(name, words).params
    return options, _flags("default", None, options["changes"] or [])


def test_it_takes_the_arguments_of_nav2s_launch_file(launch_file: dict[str, Any]) -> None:
    *arguments, _ = launch_file["generate_launch_description"]()
    assert {each.name for each in arguments} >= NAV2_ARGUMENTS


def test_by_default_it_starts_the_bridge_with_its_own_parameters(launch_file: dict[str, Any]) -> None:
    process = started(launch_file, map="/maps/map.yaml")
    options, flags = read(process.cmd)
    assert (str(options["map_or_model"]), options["robot"], options["viewer"]) == (
        "/maps/map.yaml",
        "robot",
        False,
    )
    assert options["together"] is False
    given = yaml.safe_load((PACKAGE / "params/eigenscan.yaml").read_text())["eigenscan"]["ros__parameters"]
    assert {flag.partition("=")[0] for flag in flags["ros-bridge"]} == {
        f"--{name.replace('_', '-')}" for name in given
    }
    assert (process.respawn, process.additional_env) == (False, {"EIGENSCAN_LOG_LEVEL": "info"})


@pytest.mark.parametrize("section", [["amcl"], ["/r17/amcl"], ["r17", "amcl"], ["/**", "amcl"]])
def test_nav2s_own_parameters_count(launch_file: dict[str, Any], section: list[str], tmp_path: Path) -> None:
    path = tmp_path / "nav2.yaml"
    path.write_text(yaml.safe_dump(nested(section, AMCL)))
    process = started(
        launch_file, params_file=str(path), namespace="/r17", use_composition="True", use_respawn="true",
        log_level="warn", dialect="ros2dds",
    )  # fmt: skip
    options, flags = read(process.cmd)
    assert options["map_or_model"] is None
    assert (options["ros2"], options["together"], process.respawn) == ("ros2dds", True, True)
    assert process.additional_env == {"EIGENSCAN_LOG_LEVEL": "warning"}
    bridge = dict(flag.split("=", 1) for flag in flags["ros-bridge"])
    assert bridge == {
        "--base-frame": "base_footprint", "--odom-frame": "wheels", "--tf-broadcast": "false",
        "--scan": '["front/scan"]', "--namespace": "/r17",
        "--start-known": "true", "--start-x": "2.0", "--start-y": "-1.5", "--start-yaw": "0.7",
    }  # fmt: skip
    assert flags["mapbuilder"] == ["--frame-id=site"]


@pytest.mark.parametrize(
    ("environment", "dialect"),
    [
        ({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp", "ROS_DISTRO": "jazzy"}, "rmw_zenoh"),
        ({"RMW_IMPLEMENTATION": "rmw_zenoh_cpp", "ROS_DISTRO": "humble"}, "rmw_zenoh_humble"),
        ({"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, "ros2dds"),
        ({}, "ros2dds"),
    ],
)
def test_the_dialect_is_that_of_the_robots_ros(
    launch_file: dict[str, Any], environment: dict[str, str], dialect: str
) -> None:
    assert launch_file["dialect"](environment) == dialect


def test_colcon_finds_a_package() -> None:
    root = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert (root.tag, root.get("format"), root.findtext("name")) == ("package", "3", PACKAGE.name)
    assert root.findtext("export/build_type") == root.findtext("buildtool_depend") == "ament_cmake"
    assert all(root.findtext(tag) for tag in ("version", "description", "maintainer", "license"))
    build = (PACKAGE / "CMakeLists.txt").read_text()
    assert f"project({PACKAGE.name} " in build
    folders = build.partition("install(DIRECTORY ")[2].partition(" DESTINATION")[0].split()
    assert sorted(folders) == sorted(path.name for path in PACKAGE.iterdir() if path.is_dir())
