"""What is compiled before the first scan is what a scan needs."""

from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.warm_up import warm_up


def test_both_scans_are_answered() -> None:
    # hypotheses and obstacles of each
    assert warm_up(ProjectorSettings()) == 4
