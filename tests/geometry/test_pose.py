import math

import numpy as np
import pytest
from eigenscan.geometry import circle, pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from hypothesis import given
from hypothesis import strategies as st

metres = st.floats(-100, 100)
angle = st.floats(-20, 20)
poses = st.tuples(metres, metres, angle).map(np.array)


def matrix(p: np.ndarray) -> np.ndarray:
    c, s = math.cos(p[2]), math.sin(p[2])
    return np.array([[c, -s, p[0]], [s, c, p[1]], [0, 0, 1]])


@given(a=poses, b=poses)
def test_composition_is_the_product_of_matrices(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(matrix(pose.compose(a, b)), matrix(a) @ matrix(b), atol=1e-9)
    np.testing.assert_allclose(matrix(pose.inverse(a)), np.linalg.inv(matrix(a)), atol=1e-9)
    np.testing.assert_allclose(matrix(pose.compose(a, pose.between(a, b))), matrix(b), atol=1e-9)


@given(a=poses, point=st.tuples(metres, metres))
def test_points_are_carried_by_the_matrix(a: np.ndarray, point: tuple[float, float]) -> None:
    expected = matrix(a) @ [*point, 1]
    np.testing.assert_allclose(pose.transform(a, point), expected[:2], atol=1e-9)


def test_composition_broadcasts() -> None:
    a, b = np.random.default_rng(1).normal(size=(4, 1, 3)), np.random.default_rng(2).normal(size=(5, 3))
    every = pose.compose(a, b)
    assert every.shape == (4, 5, 3)
    np.testing.assert_allclose(every[2, 3], pose.compose(a[2, 0], b[3]))


@given(angle=st.floats(-1e4, 1e4))
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = float(circle.wrap(angle))
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize(
    "angle", [math.pi, -math.pi, 3 * math.pi, -1e-20, np.nextafter(-math.pi, -4), -5 * math.pi]
)
def test_the_seam_is_at_minus_pi(angle: float) -> None:
    assert -math.pi <= circle.wrap(angle) < math.pi


@given(a=angle, turn=st.floats(-3.1, 3.1))
def test_differences_are_the_shortest_turn(a: float, turn: float) -> None:
    assert float(circle.difference(a + turn, a)) == pytest.approx(turn, abs=1e-9)


@given(a=poses)
def test_poses_come_back_from_messages(a: np.ndarray) -> None:
    np.testing.assert_array_equal(pose.from_message(pose.to_message(a)), a)
    np.testing.assert_allclose(matrix(pose.from_pose3(pose.to_pose3(a))), matrix(a), atol=1e-9)


def test_covariances_come_back_from_messages() -> None:
    root = np.random.default_rng(3).normal(size=(3, 3))
    covariance = root @ root.T
    back = pose.covariance_from_message(pose.covariance_to_message(covariance))
    np.testing.assert_allclose(back, covariance, rtol=1e-12)


def test_yaw_of_a_tilted_rotation() -> None:
    # yaw 0.5, then pitch 0.3, then roll -0.2 (z-y-x)
    yaw, pitch, roll = 0.5, 0.3, -0.2
    c, s = np.cos(np.array([yaw, pitch, roll]) / 2), np.sin(np.array([yaw, pitch, roll]) / 2)
    q = Quaternion(
        w=c[0] * c[1] * c[2] + s[0] * s[1] * s[2],
        x=c[0] * c[1] * s[2] - s[0] * s[1] * c[2],
        y=c[0] * s[1] * c[2] + s[0] * c[1] * s[2],
        z=s[0] * c[1] * c[2] - c[0] * s[1] * s[2],
    )
    assert pose.yaw(q) == pytest.approx(yaw)
