"""ros-bridge as a process."""

from __future__ import annotations

from eigenscan.ros_bridge.core import RosBridgeCore
from eigenscan.schemas.extra import needs

with needs("eigenscan-ros-bridge[node]", SystemExit):
    from eigenscan.ros_bridge.options import RosBridgeOptions
    from eigenscan.ros_bridge.port import RosPort
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run


def _make_core(options: RosBridgeOptions) -> RosBridgeCore:
    return RosBridgeCore(options, options.site, options.robot)


SERVICE = Service("ros-bridge", RosBridgeOptions, _make_core, make_port=RosPort, prompt=True)


def main() -> None:
    """Entry point of `eigenscan-ros-bridge`."""
    run(SERVICE)


if __name__ == "__main__":
    main()
