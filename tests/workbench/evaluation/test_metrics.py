import numpy as np
import pytest
from eigenscan.geometry.pose import to_message
from eigenscan.schemas.envelope import stamp
from eigenscan.schemas.tracking_pb2 import STATE_LOCALIZED, PoseEstimate
from eigenscan.workbench.evaluation.figures import finite
from eigenscan.workbench.evaluation.metrics import (
    Stream,
    calibration,
    calibration_error,
    judge,
    normalised_errors,
    right,
    summary,
    sustained,
)
from eigenscan.workbench.evaluation.pipeline import _Published, _stream
from eigenscan.workbench.evaluation.reference import NS, Trajectory
from hypothesis import given
from hypothesis import strategies as st

DEGREE = np.pi / 180


def reference(n: int) -> Trajectory:
    stamps = np.arange(n) * (NS // 10)
    poses = np.stack([0.1 * np.arange(n), np.zeros(n), np.full(n, np.pi - 1e-3)], axis=1)
    return Trajectory(stamps, poses)


def stream(truth: Trajectory, offsets: np.ndarray, localized: list[bool]) -> Stream:
    n = len(localized)
    return Stream(
        stamps=truth.stamps[:n],
        poses=truth.poses[:n] + offsets,
        states=np.where(localized, 3, 1),
        localized=np.asarray(localized),
        tracked=np.ones(n, dtype=np.bool_),
        confidence=np.full(n, 0.5),
        covariances=np.tile(np.eye(3), (n, 1, 1)),
        nis=np.full(n, np.nan),
        cpu_s=np.linspace(0.0, 0.001 * (n - 1), n),
        scans=np.arange(n),
    )


@given(st.lists(st.booleans(), max_size=30))
def test_sustained_is_the_longest_suffix_of_at_least_3(held: list[bool]) -> None:
    expected = next((i for i in range(len(held) - 2) if all(held[i:])), None)
    assert sustained(np.asarray(held, dtype=np.bool_)) == expected


@given(
    st.lists(
        st.tuples(st.floats(-1.2, 1.2), st.floats(-1.2, 1.2), st.floats(-25, 25), st.booleans()),
        min_size=1,
        max_size=20,
    )
)
def test_each_pose_is_judged_by_the_definition(rows: list[tuple[float, float, float, bool]]) -> None:
    truth = reference(20)
    offsets = np.asarray([(x, y, turn * DEGREE) for x, y, turn, _ in rows])
    judged = judge(stream(truth, offsets, [row[3] for row in rows]), truth)
    for index, (x, y, turn, claimed) in enumerate(rows):
        correct = (x * x + y * y) ** 0.5 <= 0.5 and abs(turn) <= 10
        assert judged.false_claims[index] == (claimed and not correct)
        assert judged.right_claims[index] == (claimed and correct)
        apart = (x * x + y * y) ** 0.5 > 1.0 or abs(turn) > 20
        assert judged.elsewhere_claims[index] == (claimed and apart)


def test_a_heading_past_the_half_turn_is_near() -> None:
    assert right([0.0], [9.99 * DEGREE]).all()
    truth = reference(3)
    judged = judge(stream(truth, np.tile([0, 0, 2 * np.pi + 2e-3], (3, 1)), [True] * 3), truth)
    np.testing.assert_allclose(judged.heading_rad, 2e-3, atol=1e-9)
    assert judged.converged == 0


def test_poses_that_are_not_finite_are_wrong() -> None:
    truth = reference(4)
    offsets = np.zeros((4, 3))
    offsets[3, 0] = np.nan
    judged = judge(stream(truth, offsets, [True] * 4), truth)
    assert judged.false_claims.tolist() == [False, False, False, True]
    assert judged.elsewhere_claims.tolist() == [False, False, False, True]
    assert judged.converged is None


def test_convergence_ends_with_a_lapse_of_claim_or_of_truth() -> None:
    truth = reference(10)
    claims = [False, True, True, False, True, True, True, True, True, True]
    assert judge(stream(truth, np.zeros((10, 3)), claims), truth).converged == 4
    offsets = np.zeros((10, 3))
    offsets[8, 1] = 0.6
    assert judge(stream(truth, offsets, claims), truth).converged is None


def test_a_pipeline_that_falls_silent_is_not_right_to_the_end() -> None:
    """Scans that scan-ingest sets aside bring no pose: without them, its last pose would end the window."""
    truth = reference(600)
    spoken = [
        _Published(PoseEstimate(timestamp=stamp(own), pose=to_message(pose), state=STATE_LOCALIZED), 0.0)
        for own, pose in zip(truth.stamps[:40].tolist(), truth.poses[:40], strict=True)
    ]
    whole = _stream(spoken, np.full(40, np.nan), truth.stamps)
    assert judge(whole, truth).right_claims.sum() == 40
    assert judge(whole, truth).converged is None
    # the next second's scans have their answer
    assert len(whole) == 600 - 10
    assert whole.stamps[-1] == truth.stamps[-1]
    to_its_end = _stream(spoken, np.full(40, np.nan), truth.stamps[:45])
    assert judge(to_its_end, truth).converged == 0


def test_what_has_no_reference_is_not_judged() -> None:
    truth = reference(10)
    cut = Trajectory(truth.stamps[5:], truth.poses[5:])
    judged = judge(stream(truth, np.zeros((10, 3)), [True] * 10), cut)
    assert len(judged.stream) == 5
    assert judged.stream.scans[judged.converged or 0] == 5


def test_calibration_error_of_an_honest_and_of_a_boastful_source() -> None:
    rng = np.random.default_rng(1)
    published = rng.uniform(0, 1, 200_000)
    honest = calibration_error(calibration(published, rng.uniform(0, 1, 200_000) < published))
    assert honest is not None
    assert honest < 0.01
    assert calibration_error(calibration(np.full(100, 0.9), np.arange(100) < 60)) == pytest.approx(0.3)
    # two bins: 0.95 stated and 0.5 right for one pose in four, 0.05 stated and none right for the rest
    mixed = calibration_error(
        calibration(np.array([0.95] * 10 + [0.05] * 30), np.array([True] * 5 + [False] * 35))
    )
    assert mixed == pytest.approx((10 * 0.45 + 30 * 0.05) / 40)
    assert calibration_error([]) is None


def test_confidence_of_one_and_beyond_has_a_bin() -> None:
    diagram = calibration(np.array([1.0, 1.0, 0.0]), np.array([True, True, False]))
    assert [(entry.count, entry.right) for entry in diagram] == [(1, 0.0), (2, 1.0)]


def test_summaries() -> None:
    assert summary([]) == {"median": None, "p95": None}
    assert summary([None, 3.0, float("nan"), 1.0, 2.0]) == {"median": 2.0, "p95": pytest.approx(2.9)}
    assert summary([1.0], 99) == {"median": 1.0, "p99": 1.0}


def test_normalised_errors_have_three_degrees_of_freedom() -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(3, 3))
    covariance = root @ root.T
    offsets = rng.multivariate_normal(np.zeros(3), covariance, 50_000)
    values = normalised_errors(offsets, np.tile(covariance, (50_000, 1, 1)))
    assert np.mean(values) == pytest.approx(3.0, rel=0.03)
    assert np.isnan(normalised_errors(np.ones((1, 3)), np.zeros((1, 3, 3)))).all()


def test_numbers_that_json_does_not_have_are_null() -> None:
    assert finite({"a": [1.0, float("nan"), {"b": float("inf")}], "c": 3, "d": True}) == {
        "a": [1.0, None, {"b": None}],
        "c": 3,
        "d": True,
    }


@pytest.mark.parametrize(
    ("claimed_from", "converged"),
    [(0, 0), (19, 19), (20, 20), (21, None), (27, None), (30, None)],
)
def test_a_start_succeeds_by_its_last_third_and_not_by_three_scans_at_the_end(
    claimed_from: int, converged: int | None
) -> None:
    truth = reference(30)
    claims = [row >= claimed_from for row in range(30)]
    assert judge(stream(truth, np.zeros((30, 3)), claims), truth).converged == converged


def test_one_wrong_claim_in_the_last_third_is_no_success() -> None:
    truth, offsets = reference(30), np.zeros((30, 3))
    offsets[22, 0] = 0.6
    assert judge(stream(truth, offsets, [True] * 30), truth).converged is None
