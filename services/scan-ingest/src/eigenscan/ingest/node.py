"""scan-ingest as a process."""

from __future__ import annotations

from eigenscan.ingest.core import ScanIngestCore
from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.extra import needs

with needs("eigenscan-scan-ingest[node]", SystemExit):
    from eigenscan.ingest.options import ScanIngestOptions
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run


SERVICE = Service("scan-ingest", ScanIngestOptions, ScanIngestCore, quick=True, lives_on=SCAN_RAW)


def main() -> None:
    """Entry point of `eigenscan-scan-ingest`."""
    run(SERVICE)


if __name__ == "__main__":
    main()
