"""Global localization as a library: a map in, poses of scans out, without Zenoh and without processes.

The cores are those of the services, so a notebook gets the answers that a robot gets.
"""

from eigenscan.localize.answers import Estimate, Hypotheses
from eigenscan.localize.localizer import Localizer
from eigenscan.localize.logs import read_log
from eigenscan.localize.scan import Scan, ScanError

__all__ = ["Estimate", "Hypotheses", "Localizer", "Scan", "ScanError", "read_log"]
