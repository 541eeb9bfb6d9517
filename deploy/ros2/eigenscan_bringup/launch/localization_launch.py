"""Starts `eigenscan run` with the arguments of nav2_bringup's localization_launch.py.

A parameter file is Nav2's own or params/eigenscan.yaml: its sections `amcl` and `eigenscan` count.
"""

import json
import os
from pathlib import Path

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "namespace": ("", "namespace of topics and services"),
    "map": ("", "map yaml, or a model folder; empty: the robot's /map"),
    "params_file": (
        str(Path(__file__).parents[1] / "params/eigenscan.yaml"),
        "Nav2's parameters, or the bridge's",
    ),
    "use_composition": ("False", "all services in one process"),
    "use_respawn": ("False", "start it again if it ends"),
    "log_level": ("info", "debug, info, warn or error"),
    "robot": ("robot", "name of the robot on Eigenscan's side"),
    "dialect": ("", "rmw_zenoh, rmw_zenoh_humble or ros2dds; empty: by RMW_IMPLEMENTATION and ROS_DISTRO"),
    "router": ("tcp/localhost:7447", "where rmw_zenohd or zenoh-bridge-ros2dds listens"),
    "use_sim_time": ("False", "accepted; only stamps are compared"),
    "autostart": ("True", "accepted; it works from the start"),
    "container_name": ("nav2_container", "accepted, without effect"),
    "use_intra_process_comms": ("False", "accepted, without effect"),
}
"""Each one's default and meaning."""
OF_AMCL = {
    "base_frame_id": "ros-bridge.base_frame",
    "odom_frame_id": "ros-bridge.odom_frame",
    "tf_broadcast": "ros-bridge.tf_broadcast",
    "global_frame_id": "mapbuilder.frame_id",
    "set_initial_pose": "ros-bridge.start_known",
}
OF_INITIAL_POSE = {"x": "ros-bridge.start_x", "y": "ros-bridge.start_y", "yaw": "ros-bridge.start_yaw"}
LEVELS = {"warn": "warning", "fatal": "error"}


def parameters(content, node):
    """All of one node in a parameter file, whatever namespace they are under."""
    found = {}
    for name, value in content.items() if isinstance(content, dict) else ():
        if name.rpartition("/")[2] == node and isinstance(value, dict):
            found.update(value.get("ros__parameters") or {})
        elif name != "ros__parameters":
            found.update(parameters(value, node))
    return found


def settings(content):
    """What the parameters change, as SERVICE.SETTING=VALUE; those of `eigenscan` win."""
    of_amcl = parameters(content, "amcl")
    changes = {place: of_amcl[name] for name, place in OF_AMCL.items() if name in of_amcl}
    start = of_amcl.get("initial_pose") or {}
    changes.update({place: start[name] for name, place in OF_INITIAL_POSE.items() if name in start})
    if "scan_topic" in of_amcl:
        changes["ros-bridge.scan"] = [of_amcl["scan_topic"]]
    changes.update({f"ros-bridge.{name}": value for name, value in parameters(content, "eigenscan").items()})
    texts = {
        place: value if isinstance(value, str) else json.dumps(value) for place, value in changes.items()
    }
    return [f"{place}={text}" for place, text in texts.items()]


def dialect(environment):
    """What the robot's ROS speaks on Zenoh."""
    if environment.get("RMW_IMPLEMENTATION") != "rmw_zenoh_cpp":
        return "ros2dds"
    return "rmw_zenoh_humble" if environment.get("ROS_DISTRO") == "humble" else "rmw_zenoh"


def command(given, environment):
    """The command line for launch arguments."""
    text = Path(given["params_file"]).read_text(encoding="utf-8")
    changes = settings(yaml.safe_load(text) or {})
    if given["namespace"].strip("/"):
        changes.append(f"ros-bridge.namespace={given['namespace']}")
    line = ["eigenscan", "run", *([given["map"]] if given["map"] else [])]
    line += ["--robot", given["robot"], "--ros2", given["dialect"] or dialect(environment)]
    line += ["--ros2-router", given["router"], "--no-viewer"]
    if given["use_composition"].lower() == "true":
        line.append("--together")
    return line + [word for change in changes for word in ("--set", change)]


def start(context):
    """The process, once the arguments are known."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [
        ExecuteProcess(
            cmd=command(given, os.environ),
            additional_env={"EIGENSCAN_LOG_LEVEL": LEVELS.get(given["log_level"], given["log_level"])},
            respawn=given["use_respawn"].lower() == "true",
            respawn_delay=2.0,
            output="screen",
        )
    ]


def generate_launch_description():
    """As launch asks for it."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=about)
        for name, (default, about) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])
