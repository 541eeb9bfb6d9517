"""scan-ingest as a process."""

from __future__ import annotations

from eigenscan.schemas.channels import SCAN_RAW
from eigenscan.schemas.envelope import Core
from eigenscan.schemas.extra import needs

with needs("eigenscan-scan-ingest[node]", SystemExit):
    from eigenscan.ingest.options import ScanIngestOptions
    from eigenscan.runtime.node import Service
    from eigenscan.runtime.node import main as run


def make_core(options: ScanIngestOptions) -> Core:
    """The core."""
    from eigenscan.ingest.core import ScanIngestCore  # it takes its time, and neighbours are found meanwhile

    return ScanIngestCore(options)


SERVICE = Service("scan-ingest", ScanIngestOptions, make_core, quick=True, lives_on=SCAN_RAW, compiles=True)


def main() -> None:
    """Entry point of `eigenscan-scan-ingest`."""
    run(SERVICE)


if __name__ == "__main__":
    main()
