"""Scans of real buildings: at home they are found, in another building's map they are not squeezed in."""

from functools import cache

import numpy as np
import pytest
from eigenscan.geometry.gridmap import read_map
from eigenscan.geometry.pose import covariance_from_message
from eigenscan.mapbuilder.site import Plan, build_site
from eigenscan.projector.core import ProjectorCore
from eigenscan.schemas.hypotheses_pb2 import Hypotheses
from eigenscan.schemas.scan_pb2 import Scan
from eigenscan.workbench.evaluation.log import Log, read_log
from eigenscan.workbench.logs.log import LogOptions

from tests.environment import DATASETS
from tests.services.projector.office import ready, receive, scan_at

LOGS = {
    "intel": ("log.clf.gz", ()),
    "guardian": ("guardian_3.bag", ("/scan",)),
    "jarvis": ("jarvis_complex_path_fast.bag", ("/driver_laser_navigation/laser_scan",)),
}
pytestmark = pytest.mark.skipif(not DATASETS.is_dir(), reason="the datasets are not beside the project")


@cache
def real_scans(folder: str, count: int = 25) -> list[Scan]:
    name, lidars = LOGS[folder]
    log = read_log(DATASETS / folder / name, LogOptions(lidars=lidars), lambda _: None)
    stamps = log.scans[np.linspace(0, len(log.scans) - 1, count).astype(np.int64)]
    found = [log.nearest_scan(int(stamp), 1e-3) for stamp in stamps]
    scans = [Log.canonical(scan.envelope) for scan in found if scan is not None]
    return [scan for scan in scans if scan is not None]


@cache
def at_home(folder: str) -> ProjectorCore:
    return ready(build_site(read_map(DATASETS / folder / "map.yaml"), Plan()))


def confidence(message: Hypotheses) -> float:
    """Probability of the first pose, a place off the map being as likely as the map."""
    if not message.hypotheses:
        return 0.0
    C = np.array([covariance_from_message(h.covariance) for h in message.hypotheses])
    mass = 1.5 * np.log(2 * np.pi) + 0.5 * np.linalg.slogdet(C)[1]
    mass -= np.log(message.searched_area_m2 * 2 * np.pi)
    odds = np.array([h.log_likelihood for h in message.hypotheses]) + mass
    rest = [0.0, message.unlisted_log_likelihood]
    return float(np.exp(odds[0] - np.logaddexp.reduce([*odds, *rest])))


@pytest.mark.parametrize(
    ("home", "stranger"),
    [
        ("intel", "jarvis"),
        ("intel", "guardian"),
        ("jarvis", "intel"),
        ("guardian", "intel"),
        ("guardian", "jarvis"),
    ],
)
def test_scans_of_another_building_are_not_squeezed_into_the_best_room(home: str, stranger: str) -> None:
    core = at_home(home)
    own = [confidence(receive(core, scan)[0]) for scan in real_scans(home)]
    foreign = [confidence(receive(core, scan)[0]) for scan in real_scans(stranger)]
    assert np.median(own) > 0.8
    assert np.mean(np.array(foreign) > 0.5) < 0.1
    assert np.max(foreign) < 0.95


@pytest.mark.parametrize("ranges", [1.0, 5.0, 25.0])
def test_a_scan_of_one_range_all_round_is_nowhere(ranges: float) -> None:
    core = at_home("intel")
    scan = scan_at(np.zeros(3))
    scan.ranges[:] = [ranges] * len(scan.ranges)
    assert confidence(receive(core, scan)[0]) < 0.2


def test_a_lidar_with_a_cover_on_half_of_its_view_still_states_what_it_knows() -> None:
    core = at_home("jarvis")
    reported = []
    for scan in real_scans("jarvis"):
        half = Scan()
        half.CopyFrom(scan)
        covered = np.array(scan.ranges)
        covered[: len(covered) // 2] = 0.1
        half.ranges[:] = covered.tolist()
        message, _ = receive(core, half)
        reported.append(confidence(message))
        assert message.used_beams <= 91
    assert np.median(reported) > 0.8
