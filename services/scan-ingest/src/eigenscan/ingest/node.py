"""scan-ingest as a process."""

from __future__ import annotations

from eigenscan.ingest.core import ScanIngestCore
from eigenscan.schemas.extra import needs

with needs("eigenscan-scan-ingest[node]", SystemExit):
    from eigenscan.ingest.options import ScanIngestOptions
    from eigenscan.runtime.node import main as run


def main() -> None:
    """Entry point of `eigenscan-scan-ingest`."""
    run("scan-ingest", ScanIngestOptions, ScanIngestCore)


if __name__ == "__main__":
    main()
