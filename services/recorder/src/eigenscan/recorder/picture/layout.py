"""Names of the layouts."""

from __future__ import annotations

from typing import Literal

Layout = Literal["operator", "developer", "researcher", "fleet"]
