"""Transforms and tracks at the rates that their readers need, by stamps; every pose all the same."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from eigenscan.geometry.pose import compose
from eigenscan.schemas.channels import POSE, TRACKS, TRANSFORM
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.tracking_pb2 import Tracks

from tests.services.tracker.conftest import MakeCore, Speaker
from tests.services.tracker.test_at_once import START, at, drive, published


def gaps(envelopes: list[Envelope]) -> np.ndarray:
    """s between the stamps (n - 1,)."""
    return np.diff([envelope.stamp for envelope in envelopes]) * 1e-9


def test_transforms_are_apart_by_what_is_set(make_core: MakeCore, speaker: Speaker) -> None:
    received = drive(speaker, 6.0)
    each = published(make_core(transform_hz=inf), received)[TRANSFORM]
    assert gaps(each) == pytest.approx(0.02)
    some = published(make_core(transform_hz=20.0), received)[TRANSFORM]
    # odometry comes every 20 ms: 50 ms are reached by the third
    assert gaps(some) == pytest.approx(0.06)
    assert some[0].stamp == each[0].stamp


def test_tracks_are_thinned_and_poses_are_not(make_core: MakeCore, speaker: Speaker) -> None:
    received = [speaker.odometry(100.0 + 0.02 * k, at(0.02 * k)) for k in range(150)]
    times = 0.0131 + 0.025 * np.arange(110)
    received += [speaker.hypotheses(100.0 + t, [compose(START, at(t))], [25.0]) for t in times]
    received.sort(key=lambda envelope: envelope.stamp)
    found = published(make_core(), received)
    assert len(found[POSE]) == len(times)
    assert gaps(found[TRACKS]) == pytest.approx(0.1, abs=1e-6)
    assert len(published(make_core(tracks_hz=inf), received)[TRACKS]) == len(times)


def test_only_tracks_in_play_come_with_their_past(make_core: MakeCore, speaker: Speaker) -> None:
    wrong = compose(START, np.array([9.0, 9.0, 1.0]))
    received = list[Envelope]()
    for k in range(20):
        places, time = [compose(start, at(0.3 * k)) for start in (START, wrong)], 100.0 + 0.3 * k
        received += [speaker.odometry(time, at(0.3 * k)), speaker.hypotheses(time, places, [19.0, 14.0])]
    pasts = dict[bool, list[int]]()
    for envelope in published(make_core(), received)[TRACKS][5:]:
        for track in envelope.open(Tracks).tracks:
            pasts.setdefault(track.probability >= 0.01, []).append(len(track.history))
    assert min(pasts[True]) >= 3
    assert set(pasts[False]) == {0}


def test_a_lidar_whose_stamps_jitter_loses_none(make_core: MakeCore, speaker: Speaker) -> None:
    rng = np.random.default_rng(1)
    times = 0.1 * np.arange(1, 30) + rng.uniform(-0.004, 0.004, 29)
    received = [speaker.hypotheses(100.0 + t, [START], [25.0]) for t in times]
    assert len(published(make_core(), received)[TRACKS]) == len(times)


def test_a_clock_that_was_set_back_holds_nothing_up(make_core: MakeCore, speaker: Speaker) -> None:
    core = make_core(tracks_hz=0.01)
    assert len(published(core, drive(speaker, 1.0))[TRACKS]) == 1
    back = [speaker.hypotheses(50.0 + 0.1 * k, [START], [25.0]) for k in range(10)]
    assert len(published(core, back)[TRACKS]) == 1
