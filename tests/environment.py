"""The environment of the programs under test, and where they and the logs are."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
"""Of the project."""
PROGRAMS = Path(sys.executable).parent
EIGENSCAN = PROGRAMS / "eigenscan"
DATASETS = ROOT.parent / "shared/datasets"
"""Real logs, beside the project; tests of them are marked `dataset`."""

PATIENT = {
    # that services get to end: on a busy machine the two seconds that they take by default may be too few
    "EIGENSCAN_STOP_S": "60",
    # nor may they pass scans over there, where a test counts the answers
    "EIGENSCAN_BEHIND_AFTER": "inf",
}


def clean() -> dict[str, str]:
    """This process's, without anybody's settings of the services."""
    return {name: value for name, value in os.environ.items() if not name.startswith("EIGENSCAN_")} | PATIENT
