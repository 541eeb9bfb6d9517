"""What the recorder can be told."""

from __future__ import annotations

import math
import re
from pathlib import Path

from eigenscan.recorder.files import Limits
from eigenscan.recorder.picture.layout import Layout
from eigenscan.runtime.settings import ServiceSettings
from pydantic import Field, field_validator, model_validator

FILES_OF_A_BUDGET = 8
"""Files that a budget holds where the size of one is not given."""


class RecorderOptions(ServiceSettings):
    """Settings of the recorder. At least one of `mcap`, `rrd` and `viewer_port` must be given."""

    robot: str = Field("*", description="robot to record; * records every robot of the site")
    behind_after: float = Field(math.inf, ge=0, description="s; it wants all")
    mcap: Path | None = Field(
        None, description="folder for MCAP files, or one file ending in .mcap; none is ever overwritten"
    )
    flush_s: float = Field(
        0.5, gt=0, le=60, description="s of traffic at most that a kill may cost the MCAP file"
    )
    rotate_mb: float | None = Field(
        None, gt=0, description="MB after which the next MCAP file begins; an eighth of budget_mb without it"
    )
    rotate_minutes: float = Field(60.0, gt=0, description="minutes after which the next MCAP file begins")
    budget_mb: float | None = Field(
        None, gt=0, description="MB that all MCAP files of this recorder may take: the oldest are deleted"
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
    layout: Layout = Field(
        "operator",
        description="what the picture shows first: operator, developer, researcher, or fleet (many robots)",
    )
    picture_hz: float = Field(
        10.0,
        gt=0,
        le=1000,
        description="pictures per second and robot at most; plots and MCAP take everything",
    )
    plot_window_s: float = Field(120.0, gt=0, description="s of the past that the live time plots show")

    @property
    def limits(self) -> Limits:
        """Those of the MCAP files."""
        share = self.budget_mb / FILES_OF_A_BUDGET if self.budget_mb else None
        file_mb = self.rotate_mb or share
        return Limits(
            file_bytes=int(file_mb * 1e6) if file_mb else None,
            file_ns=int(self.rotate_minutes * 60e9),
            # the file in use comes on top of what is kept
            total_bytes=int((self.budget_mb - (file_mb or 0.0)) * 1e6) if self.budget_mb else None,
        )

    @model_validator(mode="after")
    def _fits(self) -> RecorderOptions:
        if self.budget_mb and self.rotate_mb and 2 * self.rotate_mb > self.budget_mb:
            raise ValueError(
                f"rotate_mb = {self.rotate_mb:g} is more than half of budget_mb = {self.budget_mb:g}: "
                "a budget must hold two files"
            )
        return self

    @field_validator("viewer_memory")
    @classmethod
    def _is_size(cls, value: str) -> str:
        if not re.fullmatch(r"\d+(\.\d+)?\s?([kMGT]i?B|%)", value):
            raise ValueError("give a size such as 256MB or 1GiB, or a share of the memory such as 10%")
        return value
