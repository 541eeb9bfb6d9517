"""ros-bridge as a process."""

from __future__ import annotations

from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.ros_bridge.port import RosPort
from eigenscan.ros_bridge.settings import RosBridgeSettings
from eigenscan.runtime.node import main as run


def main() -> None:
    """Entry point of `eigenscan-ros-bridge`."""
    run("ros-bridge", RosBridgeSettings, RosBridgeCore, make_port=RosPort, prompt=True)


if __name__ == "__main__":
    main()
