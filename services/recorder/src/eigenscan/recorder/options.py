"""The settings of the recorder."""

from __future__ import annotations

import math
import re
from pathlib import Path

from eigenscan.recorder.files import Limits
from eigenscan.recorder.picture.layout import Layout
from eigenscan.runtime.settings import ServiceSettings
from pydantic import Field, field_validator, model_validator

FILES_OF_A_BUDGET = 8
"""Files in a budget, if their size is not given."""


class RecorderOptions(ServiceSettings):
    """Settings of the recorder. Give at least one of `mcap`, `rrd`, `viewer_port`, `foxglove_port`."""

    robot: str = Field("*", description="robot to record; * records every robot of the site")
    behind_after: float = Field(math.inf, ge=0, description="s; it wants all")
    mcap: Path | None = Field(
        None, description="folder for MCAP files, or one file ending in .mcap; files are never overwritten"
    )
    flush_s: float = Field(
        0.5,
        gt=0,
        le=60,
        description="seconds of traffic that a crash can lose, and 1 s in a pause",
    )
    rotate_mb: float | None = Field(
        None, gt=0, description="MB after which a new MCAP file begins; by default an eighth of budget_mb"
    )
    rotate_minutes: float = Field(60.0, gt=0, description="minutes after which a new MCAP file begins")
    budget_mb: float | None = Field(
        None, gt=0, description="MB that all MCAP files together may take; the oldest are deleted"
    )
    uploads: bool = Field(
        True,
        description="answer `eigenscan fleet fetch` with the MCAP files, where robot is one robot's name",
    )
    rrd: Path | None = Field(None, description="Rerun file to write; an existing file is replaced")
    viewer_port: int | None = Field(
        None,
        ge=0,
        le=65535,
        description="port of the live web viewer; 0 takes a free one; without it there is none",
    )
    data_port: int = Field(
        9876,
        ge=0,
        le=65535,
        description="port that the web viewer reads its data from; 0 takes a free one",
    )
    foxglove_port: int | None = Field(
        None, ge=0, le=65535, description="port that Foxglove connects to; 0 takes a free one; default: none"
    )
    viewer_host: str = Field("127.0.0.1", description="address for the viewer and its data")
    viewer_origin: str | None = Field(
        None,
        description="another origin that may read the data, such as http://r17.local:9090",
    )
    viewer_memory: str = Field(
        "256MB",
        description="memory for viewers that join later; the oldest data is dropped first",
    )
    layout: Layout = Field(
        "operator",
        description="first layout of the viewer: operator, developer, researcher, or fleet (many robots)",
    )
    picture_hz: float = Field(
        10.0,
        gt=0,
        le=1000,
        description="most updates a second for each robot; plots and MCAP get everything",
    )
    draw_all: bool = Field(
        False,
        description="also draws raw scans and coordinate frames, which fill the viewer's memory, and in the "
        "layout fleet what is left out there; MCAP gets everything in any case",
    )
    plot_window_s: float = Field(120.0, gt=0, description="seconds shown in live plots")

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
