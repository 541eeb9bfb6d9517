"""A scan that windows share is searched for once, at the cost of each time."""

import time
from dataclasses import replace

import numpy as np
import pytest
from eigenscan.projector.candidates import Candidates
from eigenscan.projector.core import ProjectorCore
from eigenscan.projector.focus import WHOLE, Scope
from eigenscan.projector.observation import Observation, observe
from eigenscan.projector.projection import find_candidates
from eigenscan.projector.settings import ProjectorSettings
from eigenscan.projector.site import SensorView, Site
from eigenscan.schemas.hypotheses_pb2 import SEARCH_LOCAL, SEARCH_WHOLE
from eigenscan.workbench.evaluation.remembering import Remembering

from tests.services.projector.office import envelopes, free_poses, receive, scan_at, site
from tests.services.projector.test_local import SURE, ask, request

SPENT_NS = 5_000_000
START, STEP = 10**15, 100_000_000


class Counting:
    """Counts what it searches, and takes its time; `waits`: regions are left to later scans."""

    def __init__(self, *, waits: bool = False) -> None:
        self.searched, self._waits = 0, waits

    def __call__(
        self, site: Site, view: SensorView, seen: Observation, settings: ProjectorSettings, *, scope: Scope
    ) -> Candidates:
        self.searched += 1
        end = time.process_time_ns() + SPENT_NS
        while time.process_time_ns() < end:
            pass
        found = find_candidates(site, view, seen, settings, scope=scope)
        return replace(found, waiting=np.arange(len(site.regions)) == 0) if self._waits else found


def taught(remembering: Remembering) -> ProjectorCore:
    core = ProjectorCore(ProjectorSettings(), search=remembering)
    for envelope in envelopes(site(spacing=1.0, components=4)):
        list(core.handle(envelope))
    return core


@pytest.fixture(scope="module")
def truths() -> np.ndarray:
    return free_poses(2, 3)


def test_the_same_scan_at_another_time_is_answered_alike_and_costs_the_same(truths: np.ndarray) -> None:
    counting = Counting()
    remembering = Remembering(counting)
    core = taught(remembering)
    first, _ = receive(core, scan_at(truths[0], time=10))
    assert remembering.owed_ns == 0
    again, obstacles = receive(core, scan_at(truths[0], time=999))
    assert counting.searched == 1
    assert remembering.owed_ns >= SPENT_NS
    assert again.timestamp.nanos == 999
    assert obstacles is not None
    again.timestamp.CopyFrom(first.timestamp)
    assert again == first


def test_another_scan_is_searched_for_and_after_forgetting_each(truths: np.ndarray) -> None:
    counting = Counting()
    remembering = Remembering(counting)
    core = taught(remembering)
    for truth in truths:
        receive(core, scan_at(truth))
    assert counting.searched == 2
    remembering.forget()
    receive(core, scan_at(truths[0]))
    assert counting.searched == 3


def test_what_may_find_more_the_next_time_is_not_kept(truths: np.ndarray) -> None:
    counting = Counting(waits=True)
    core = taught(Remembering(counting))
    for time_ns in (1, 2):
        receive(core, scan_at(truths[0], time=time_ns))
    assert counting.searched == 2


def test_a_search_of_some_regions_is_neither_kept_nor_taken_for_one_of_all(truths: np.ndarray) -> None:
    counting = Counting()
    remembering = Remembering(counting)
    core = taught(remembering)
    assert core._site is not None
    seen = observe(scan_at(truths[0]))
    view = core._site.view(seen.sensor)
    some = Scope(np.ones(len(core._site.regions), dtype=bool))
    for scope in (some, WHOLE, some, WHOLE):
        remembering(core._site, view, seen, ProjectorSettings(), scope=scope)
    assert counting.searched == 3


def test_local_fits_go_on_where_the_search_before_was_remembered(truths: np.ndarray) -> None:
    core = taught(Remembering())
    for begin in (START, START + 10**12):
        core.forget_robots()
        searches = [receive(core, scan_at(truths[0], time=begin))[0].search]
        ask(core, request(truths[0], begin, covariance=SURE))
        searches.append(receive(core, scan_at(truths[0], time=begin + STEP))[0].search)
        assert searches == [SEARCH_WHOLE, SEARCH_LOCAL]


def test_who_forgets_robots_answers_no_earlier_request(truths: np.ndarray) -> None:
    core = taught(Remembering())
    receive(core, scan_at(truths[0], time=START))
    ask(core, request(truths[0], START))
    core.forget_robots()
    assert receive(core, scan_at(truths[0], time=START + STEP))[0].search == SEARCH_WHOLE
