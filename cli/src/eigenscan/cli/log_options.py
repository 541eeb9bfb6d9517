"""Options of the commands that read a log."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LogFile = Annotated[
    Path, typer.Argument(metavar="LOG", help="CARMEN log, ROS 1 or 2 bag (folder or file), MCAP or CSV")
]
LidarTopics = Annotated[
    list[str] | None,
    typer.Option("--lidar-topic", help="topic or lidar name to take; repeat for more; default: all"),
]
OdometryTopic = Annotated[str | None, typer.Option("--odometry-topic", help="topic of the odometry")]
