"""What the zenoh-bridge-ros2dds publishes on Zenoh: `python -m tests.services.ros_bridge.record_dds BRIDGE`.

Writes `recorded_dds.json`, against which `test_recorded_dds.py` holds the bridge's dialect without a build.
PROGRAM is what `pytest -m rust tests/services/ros_bridge` has built, `out/rust/release/dds-bridge`.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import zenoh
from cyclonedds.core import Policy, Qos
from eigenscan.ros_bridge import cdr

from tests.network import free_port
from tests.services.ros_bridge import dds_robot as dds
from tests.services.ros_bridge.test_core import TIME
from tests.services.ros_bridge.test_recorded_dds import RECORDED

DOMAIN = 101


def hashed(qos: Qos, kind: str) -> Qos:
    """With the type's hash as ROS 2 shows it."""
    return qos + Qos(Policy.Userdata(f"typehash={cdr.type_hash(kind)};".encode()))


def main() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    alone = {"scouting": {"multicast": {"enabled": False}}}
    about: dict[str, Any] = {"timestamping": {"enabled": True}, "adminspace": {"enabled": True}}
    about |= {"plugins_loading": {"enabled": True}, "plugins": {"ros2dds": {"domain": DOMAIN}}}
    config = {"mode": "router", "listen": {"endpoints": [endpoint]}, **alone, **about}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bridge.json5"
        path.write_text(json.dumps(config))
        os.environ["CYCLONEDDS_URI"] = dds.CYCLONE
        with subprocess.Popen([sys.argv[1], path], env={**os.environ, "ROS_DISTRO": "jazzy"}) as process:
            time.sleep(2.0)
            client = {"mode": "client", "connect": {"endpoints": [endpoint]}, **alone}
            with zenoh.open(zenoh.Config.from_json5(json.dumps(client))) as session:
                recorded = record(session)
            process.terminate()
    RECORDED.write_text(json.dumps(recorded, indent=1) + "\n")


def record(session: zenoh.Session) -> dict[str, Any]:
    robot = dds.DdsRobot(DOMAIN)
    messages = published_by(robot)
    samples: dict[str, dict[str, str | None]] = {}

    def keep(sample: zenoh.Sample) -> None:
        samples.setdefault(str(sample.key_expr), as_text(sample.payload, sample.attachment))

    subscriber = session.declare_subscriber("**", keep)
    requests: dict[str, dict[str, str | None]] = {}

    def answer(query: zenoh.Query) -> None:
        with query:
            requests[str(query.key_expr)] = as_text(query.payload, query.attachment)

    # a bridge that serves get_state, by its tokens and its queryable
    bridge = f"@/{session.zid()}/@ros2_lv"
    tokens = [bridge, f"{bridge}/SS/amcl§get_state/lifecycle_msgs§srv§GetState"]
    held = [session.liveliness().declare_token(token) for token in tokens]
    queryable = session.declare_queryable("amcl/get_state", answer)
    client = robot.outputs("rq/amcl/get_stateRequest", dds.GetStateRequest)
    robot.inputs("rr/amcl/get_stateReply", dds.GetStateResponse)
    for _ in range(40):
        for writer, message in messages:
            writer.write(message)
        client.write(dds.GetStateRequest(77, 5, 0))
        time.sleep(0.1)
    replies = session.liveliness().get("@/*/@ros2_lv/**", timeout=2.0)
    keys = [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
    shown = sorted(
        key.split("/", 3)[3] for key in keys if str(session.zid()) not in key and key.count("/") > 2
    )
    del held
    queryable.undeclare()
    subscriber.undeclare()
    return {"tokens": shown, "samples": samples, "requests": requests}


def published_by(robot: dds.DdsRobot) -> list[tuple[Any, Any]]:
    """Declares the bridge's own topics on the DDS side, and a robot's; gives writers and messages."""
    sensor, command, tf = dds.SENSOR, dds.quality(10), dds.quality(100)
    static = dds.quality(100, latched=True)
    robot.inputs("rt/scan", dds.LaserScan, hashed(sensor, cdr.LASER_SCAN))
    robot.inputs("rt/odom", dds.Odometry, hashed(command, cdr.ODOMETRY))
    robot.inputs("rt/tf", dds.TFMessage, hashed(tf, cdr.TRANSFORMS))
    robot.inputs("rt/tf_static", dds.TFMessage, hashed(static, cdr.TRANSFORMS))
    robot.inputs("rt/initialpose", dds.PoseWithCovarianceStamped, hashed(command, cdr.POSE_WITH_COVARIANCE))
    turn, here = dds.Quaternion(0.0, 0.0, 0.6, 0.8), dds.Vector3(1.0, -2.0, 0.1)
    pose = dds.Pose(dds.Point(1.5, -2.25, 0.0), turn)
    stated = dds.PoseWithCovariance(pose, [0.01 * number for number in range(36)])
    twist = dds.Twist(dds.Vector3(0.5, 0.0, 0.0), dds.Vector3(0.0, 0.0, 0.2))
    mount = dds.TransformStamped(dds.header("base_link", TIME), "laser", dds.Transform(here, turn))
    moved = dds.TransformStamped(dds.header("odom", TIME), "base_link", dds.Transform(here, turn))
    info = dds.MapMetaData(dds.header("", TIME).stamp, 0.05, 3, 2, pose)
    particles = [dds.Particle(pose, 0.75), dds.Particle(pose, 0.25)]
    header = dds.header("map", TIME)
    scan = dds.LaserScan(
        dds.header("laser", TIME),
        -1.0,
        1.0,
        0.5,
        0.0,
        0.1,
        0.05,
        30.0,
        [1.0, 2.5, float("inf"), 0.0, 3.0],
        [7.0],
    )
    odometry = dds.Odometry(
        dds.header("odom", TIME), "base_link", stated, dds.TwistWithCovariance(twist, 36 * [0.0])
    )
    posed = dds.PoseWithCovarianceStamped(header, stated)
    latched = dds.LATCHED
    return [
        (robot.outputs("rt/scan", dds.LaserScan, hashed(sensor, cdr.LASER_SCAN)), scan),
        (robot.outputs("rt/odom", dds.Odometry, hashed(command, cdr.ODOMETRY)), odometry),
        (robot.outputs("rt/tf", dds.TFMessage, hashed(tf, cdr.TRANSFORMS)), dds.TFMessage([moved])),
        (
            robot.outputs("rt/tf_static", dds.TFMessage, hashed(static, cdr.TRANSFORMS)),
            dds.TFMessage([mount]),
        ),
        (
            robot.outputs(
                "rt/amcl_pose", dds.PoseWithCovarianceStamped, hashed(latched, cdr.POSE_WITH_COVARIANCE)
            ),
            posed,
        ),
        (
            robot.outputs("rt/particle_cloud", dds.ParticleCloud, hashed(sensor, cdr.PARTICLE_CLOUD)),
            dds.ParticleCloud(header, particles),
        ),
        (
            robot.outputs("rt/map", dds.OccupancyGrid, hashed(latched, cdr.OCCUPANCY_GRID)),
            dds.OccupancyGrid(header, info, [0, 100, -1, 100, 0, 0]),
        ),
    ]


def as_text(payload: Any, attachment: Any) -> dict[str, str | None]:
    return {
        "payload": payload.to_bytes().hex() if payload is not None else None,
        "attachment": attachment.to_bytes().hex() if attachment is not None else None,
    }


if __name__ == "__main__":
    main()
