"""The settings of scan-ingest."""

from __future__ import annotations

from eigenscan.ingest.settings import ScanIngestSettings
from eigenscan.runtime.settings import ServiceSettings


class ScanIngestOptions(ScanIngestSettings, ServiceSettings):
    """Settings of scan-ingest: any lidar frame in, one canonical scan out."""
