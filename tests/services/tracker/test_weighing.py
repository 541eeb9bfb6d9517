"""The compiled steps are the readable ones, for any belief, list and motion."""

from __future__ import annotations

from copy import deepcopy

import numpy as np
import pytest
from eigenscan.schemas.channels import POSE, TRACKS
from eigenscan.schemas.envelope import Envelope
from eigenscan.schemas.tracking_pb2 import PoseEstimate
from eigenscan.schemas.tracking_pb2 import Tracks as TracksMessage
from eigenscan.tracker import observation, robot, unification
from eigenscan.tracker.belief import Belief
from eigenscan.tracker.branching import follow
from eigenscan.tracker.core import TrackerCore
from eigenscan.tracker.observation import Observation
from eigenscan.tracker.odometry import Motion
from eigenscan.tracker.reckoning import Leg, correct
from eigenscan.tracker.settings import TrackerSettings
from eigenscan.tracker.share import Share
from eigenscan.tracker.tracks import Columns, Tracks, begin, replace
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.services.tracker import readable
from tests.services.tracker.conftest import Speaker
from tests.services.tracker.readable import Readable

EXACT = 1e-12
SPOTS = np.array([[2.0, 3.0, 0.5], [2.3, 3.1, 0.6], [9.0, 1.0, -3.1], [9.0, 1.2, 3.1], [5.0, 7.0, 2.0]])


def spread(rng: np.random.Generator, count: int) -> np.ndarray:
    root = rng.normal(size=(count, 3, 3)) * np.array([0.1, 0.15, 0.05])[:, None]
    return root @ root.swapaxes(1, 2) + np.eye(3) * 1e-4


def near_spots(rng: np.random.Generator, count: int) -> np.ndarray:
    return SPOTS[rng.integers(len(SPOTS), size=count)] + rng.normal(size=(count, 3)) * 0.1


def some_tracks(rng: np.random.Generator, count: int, sources: int, frames: int) -> Tracks:
    share = rng.dirichlet(np.full(count, 0.3)) if count else np.zeros(0)
    evidence = rng.normal(size=(count, sources)) * 3.0 * rng.integers(2, size=(count, sources))
    tracks = begin(
        near_spots(rng, count), spread(rng, count), np.log(0.7 * share + 1e-12),
        rng.uniform(0.0, 0.5 / max(count, 1), count), evidence, 1, 3,
    )  # fmt: skip
    return replace(
        tracks,
        hidden=rng.uniform(size=(count, sources)) * rng.integers(2, size=(count, sources)),
        unchecked=rng.uniform(0.0, 1.0, (count, 4)),
        frame=rng.integers(1, frames, size=count),
        id=np.arange(1, count + 1),
        parent=rng.integers(9, size=count),
        observations=rng.integers(3, size=count),
    )


def some_list(rng: np.random.Generator, count: int, source: int) -> Observation:
    unlisted = float(rng.choice([0.0, 5.0, -3.0]))
    return Observation(
        99, f"front/{source}", "front", "map", near_spots(rng, count), spread(rng, count),
        rng.normal(10.0, 6.0, count), unlisted, 400.0, True, cut=bool(rng.integers(2)),
    )  # fmt: skip


def some_belief(
    rng: np.random.Generator, kind: type[Belief], count: int, sources: int, frames: int
) -> Belief:
    belief = kind(TrackerSettings())
    for frame in range(1, frames):
        belief.frame_index("map" if frame == 1 else f"floor {frame}", 400.0 / frame)
    for source in range(sources):
        belief.source_index(f"front/{source}")
    belief.off_map_share = float(rng.uniform(0.02, 0.5))
    belief.tracks, belief.stamp, belief.next_id = some_tracks(rng, count, sources, frames), 99, count + 1
    rest = belief.elsewhere
    rest.log_weight[:] = np.log(rng.dirichlet(np.ones(frames)) * 0.3)
    rest.searched[:] = rng.uniform(size=rest.searched.shape)
    return belief


def assert_same_tracks(found: Tracks, expected: Tracks) -> None:
    for name in Columns._fields:
        one, other = getattr(found, name), getattr(expected, name)
        assert one.dtype == other.dtype, name
        np.testing.assert_allclose(one, other, rtol=EXACT, atol=EXACT, err_msg=name)


def assert_same(found: Belief, expected: Belief) -> None:
    assert_same_tracks(found.tracks, expected.tracks)
    for one, other in zip(found.elsewhere.parts(), expected.elsewhere.parts(), strict=True):
        np.testing.assert_allclose(one, other, rtol=EXACT, atol=EXACT)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 6), listed=st.integers(0, 3))
def test_tracks_follow_a_local_list_as_the_readable_ones_do(seed: int, count: int, listed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks, seen = some_tracks(rng, count, 2, 2), some_list(rng, listed, 0)
    arguments = tracks, seen, 16.0, float(rng.uniform())
    assert_same_tracks(follow(*arguments), readable.follow(*arguments))


@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 8),
    odd=st.lists(
        st.tuples(
            st.integers(0, 7),
            st.integers(0, 9),
            st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-9, 1e3, 1e7, -1e8, np.pi, -np.pi]),
        ),
        max_size=6,
    ),
    trust=st.floats(0.1, 1.0),
    poorer=st.sampled_from([0.0, 0.25]),
)
def test_what_a_message_lists_is_checked_the_same(
    seed: int, count: int, odd: list[tuple[int, int, float]], trust: float, poorer: float
) -> None:
    rng = np.random.default_rng(seed)
    C = spread(rng, count)
    rows = np.column_stack(
        [rng.normal(size=(count, 3)) * 5.0, rng.normal(9.0, 9.0, count), C[:, 0], C[:, 1, 1:], C[:, 2, 2:]]
    )
    for row, column, value in odd:
        if row < count:
            rows[row, column] = value
    found = observation.checked(rows, trust, poorer, 0.25, 0.02)
    expected = readable.checked(rows, trust, poorer, 0.25, 0.02)
    for part in range(3):
        np.testing.assert_allclose(found[part], expected[part], rtol=EXACT, atol=EXACT)
    assert found[3] == expected[3]


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    tracks=st.integers(0, 12),
    hypotheses=st.integers(0, 12),
    sources=st.integers(1, 3),
    frames=st.integers(2, 4),
    weight=st.floats(0.01, 1.0),
    progress=st.floats(0.0, 3.0),
    precision=st.floats(0.0, 1.0),
    carried=st.floats(0.0, 0.5) | st.just(0.0),
    broken=st.booleans(),
    in_part=st.booleans(),
    first=st.booleans(),
)
def test_a_list_does_the_same_to_a_belief(
    seed: int, tracks: int, hypotheses: int, sources: int, frames: int, weight: float, progress: float,
    precision: float, carried: float, broken: bool, in_part: bool, first: bool,
) -> None:  # fmt: skip
    found = some_belief(np.random.default_rng(seed), Belief, tracks, sources, frames)
    expected = some_belief(np.random.default_rng(seed), Readable, tracks, sources, frames)
    before = deepcopy(found.tracks)
    seen = some_list(np.random.default_rng(seed + 1), hypotheses, sources - 1)
    share = Share(weight, progress, precision, carried, broken, in_part, first)
    given_tracks = found.tracks
    found.observe(seen, share)
    expected.observe(seen, share)
    assert_same(found, expected)
    assert np.exp(found.tracks.log_weight).sum() + found.none_probability == pytest.approx(1.0)
    for name in Columns._fields:  # an estimate of before may still hold them
        np.testing.assert_array_equal(getattr(given_tracks, name), getattr(before, name))
    unification.settle(found)
    readable.settle(expected)
    assert_same(found, expected)
    assert found.next_id == expected.next_id


@pytest.mark.parametrize("most", [1, 3, 64])
def test_the_heaviest_are_kept_in_order(most: int) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        found, expected = (some_belief(np.random.default_rng(seed), Belief, 9, 1, 2) for _ in range(2))
        tied = rng.integers(0, 4, 9).astype(np.float64) - 20.0  # some are below the least probability
        for belief in (found, expected):
            belief.settings = TrackerSettings(max_tracks=most)
            belief.tracks = replace(belief.tracks, log_weight=np.append(tied[:-1], -30.0))
        unification.settle(found)
        readable.settle(expected)
        assert 0 < len(found.tracks) <= most
        assert_same(found, expected)


@given(seed=st.integers(0, 2**32 - 1), tracks=st.integers(0, 6), frames=st.integers(2, 4))
def test_a_jump_frees_mass_that_no_list_was_of(seed: int, tracks: int, frames: int) -> None:
    found, expected = (some_belief(np.random.default_rng(seed), Belief, tracks, 2, frames) for _ in range(2))
    found.predict(Motion((0.1, 0.0, 0.0), 0.1, 0.0, 0.0, 0.0, 2.0, 30.0))
    released = readable.release(expected.tracks, expected.elsewhere, 0.75, expected.off_map_share)
    readable.come_back(expected.elsewhere, 1.0 - np.exp(-0.01 * 30.0))
    np.testing.assert_allclose(found.tracks.log_weight, released.log_weight, rtol=EXACT)
    for one, other in zip(found.elsewhere.parts(), expected.elsewhere.parts(), strict=True):
        np.testing.assert_allclose(one, other, rtol=EXACT, atol=EXACT)


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 8), newest=st.integers(1, 9))
def test_scan_motion_corrects_tracks_the_same(seed: int, count: int, newest: int) -> None:
    """Some were fixed before the leg began, some on its way, some after it."""
    rng = np.random.default_rng(seed)
    before = some_tracks(rng, count, 1, 2)
    before = replace(before, fixed_at=rng.integers(0, newest, count))
    noise = np.diag([1.0, 2.0, 0.5]) * 1e-3 + 1e-4
    way = Leg(3, 6, (0.3, 0.1, -0.2), noise, (0.05, -0.02, 0.1))

    def motions(start: int, end: int) -> Motion:
        passed = float(end - start)
        return Motion((0.1 * passed, 0.02, 0.05 * passed), 0.1 * passed, 0.05 * passed, 0.0, 0.1, 0.0, passed)

    found = correct(before, way, 9, motions, TrackerSettings())
    expected = readable.correct(before, way, 9, motions, TrackerSettings())
    for name in Columns._fields:
        np.testing.assert_allclose(
            getattr(found, name), getattr(expected, name), rtol=EXACT, atol=EXACT, err_msg=name
        )


def story(speaker: Speaker, seed: int) -> list[Envelope]:
    """A robot among places that look alike; it is carried off, and a second projector answers late in it."""
    rng = np.random.default_rng(seed)
    stream, truth, odometry = list[Envelope](), np.array([2.0, 3.0, 0.0]), np.zeros(3)
    for scan in range(120):
        time, step = 10.0 + 0.1 * scan, np.array([0.08, 0.0, 0.03])
        truth, odometry = truth + step, odometry + step
        if scan == 60:
            truth = np.array([20.0, 9.0, 1.0])
        stream.append(speaker.odometry(time, odometry))
        alike, beside = np.add(truth, [0.0, 6.0, 0.0]), np.add(truth, [0.1, 0.1, 0.0])
        places = [truth + rng.normal(size=3) * 0.03, alike, beside]
        fits = [14.0 + rng.normal(), 13.0 + rng.normal(), 9.0]
        missed = rng.uniform() < 0.2
        stream.append(speaker.hypotheses(time, places[missed:], fits[missed:]))
        if scan >= 90:
            stream.append(speaker.hypotheses(time, places[1:], fits[1:], projector="1"))
    return stream


@pytest.mark.parametrize("seed", range(3))
def test_the_robots_answers_are_those_of_the_readable_form(
    speaker: Speaker, seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def answers() -> list[Envelope]:
        core = TrackerCore(TrackerSettings())
        published = [each for received in story(speaker, seed) for each in core.handle(received)]
        return [*published, *core.finish()]

    compiled = answers()
    monkeypatch.setattr(robot, "Belief", Readable)
    monkeypatch.setattr(robot, "settle", readable.settle)
    expected = answers()
    assert any(numbers(published) for published in compiled)
    for one, other in zip(compiled, expected, strict=True):
        assert one.channel is other.channel
        assert numbers(one) == pytest.approx(numbers(other), rel=1e-9, abs=1e-9, nan_ok=True)


def numbers(published: Envelope) -> list[float]:
    """What a pose or tracks message states."""
    if published.channel is POSE:
        pose = published.open(PoseEstimate)
        return [pose.pose.x, pose.pose.y, pose.pose.theta, pose.state, pose.confidence, pose.covariance.xx]
    if published.channel is not TRACKS:
        return []
    tracks = published.open(TracksMessage).tracks
    return [v for t in tracks for v in (t.id, t.parent_id, t.probability, t.pose.x, t.covariance.tt, t.nis)]
