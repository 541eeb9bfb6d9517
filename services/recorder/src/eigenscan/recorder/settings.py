"""What the recorder can be told."""

from __future__ import annotations

import re
from pathlib import Path

from eigenscan.runtime.settings import ServiceSettings
from pydantic import Field, field_validator


class RecorderSettings(ServiceSettings):
    """Settings of the recorder. At least one of `mcap`, `rrd` and `viewer_port` must be given."""

    robot: str = Field("*", description="robot to record; * records every robot of the site")
    mcap: Path | None = Field(
        None, description="folder for MCAP files, or one file ending in .mcap; none is ever overwritten"
    )
    flush_s: float = Field(
        0.5, gt=0, le=60, description="s of traffic at most that a kill may cost the MCAP file"
    )
    rrd: Path | None = Field(None, description="Rerun file to write the picture to; overwritten")
    viewer_port: int | None = Field(
        None, ge=0, le=65535, description="serve the live web viewer on this port; 0 chooses one; off without"
    )
    data_port: int = Field(
        9876,
        ge=0,
        le=65535,
        description="port of the picture's data, which the web viewer reads; 0 chooses one",
    )
    viewer_host: str = Field("127.0.0.1", description="address that viewer and data are served on")
    viewer_origin: str | None = Field(
        None,
        description="further origin that may read the picture's data, such as http://r17.local:9090",
    )
    viewer_memory: str = Field(
        "256MB",
        description="memory for late joining viewers; the oldest is dropped beyond it",
    )
    picture_hz: float = Field(
        10.0,
        gt=0,
        le=1000,
        description="pictures per second and robot at most; plots and MCAP take everything",
    )
    plot_window_s: float = Field(120.0, gt=0, description="s of the past that the live time plots show")

    @field_validator("viewer_memory")
    @classmethod
    def _is_size(cls, value: str) -> str:
        if not re.fullmatch(r"\d+(\.\d+)?\s?([kMGT]i?B|%)", value):
            raise ValueError("give a size such as 256MB or 1GiB, or a share of the memory such as 10%")
        return value
