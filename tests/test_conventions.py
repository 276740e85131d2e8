"""Rigid transforms as axioms: inverse, composition, distance, and what is refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from regrasp_opt import conventions
from regrasp_opt.errors import PoseError

STEADY = settings(deadline=None, derandomize=True, max_examples=60)
coordinates = arrays(np.float64, 3, elements=st.floats(-2, 2))
angles = st.floats(-10, 10)
planar = st.tuples(st.floats(-2, 2), st.floats(-2, 2), angles).map(np.array)


@st.composite
def poses(draw):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(draw(coordinates)).as_matrix()
    T[:3, 3] = draw(coordinates)
    return T


@STEADY
@given(poses(), poses())
def test_inverses(A, B):
    np.testing.assert_allclose(conventions.invert(A) @ A, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(conventions.invert(conventions.invert(A)), A, atol=1e-12)
    np.testing.assert_allclose(conventions.invert(A @ B), conventions.invert(B) @ conventions.invert(A), atol=1e-12)
    np.testing.assert_array_equal(conventions.invert(np.stack([A, B]))[1], conventions.invert(B))


@STEADY
@given(planar, planar)
def test_planar_motions_compose_and_keep_heights(a, b):
    A, B = conventions.planar_transform(a), conventions.planar_transform(b)
    c, s = np.cos(a[2]), np.sin(a[2])
    both = [a[0] + c * b[0] - s * b[1], a[1] + s * b[0] + c * b[1], a[2] + b[2]]
    np.testing.assert_allclose(A @ B, conventions.planar_transform(both), atol=1e-12)
    np.testing.assert_array_equal((A @ B)[2], [0, 0, 1, 0])
    np.testing.assert_allclose(conventions.planar_transform(a + np.array([0, 0, 2 * np.pi])), A, atol=1e-12)


@STEADY
@given(poses(), poses(), poses())
def test_distances_are_symmetric_and_blind_to_the_frame(A, B, C):
    there, back = conventions.pose_distance(A, B), conventions.pose_distance(B, A)
    np.testing.assert_allclose(there, back, atol=1e-9)
    np.testing.assert_allclose(conventions.pose_distance(C @ A, C @ B), there, atol=1e-9)
    assert conventions.pose_distance(A, A) == (0.0, pytest.approx(0.0, abs=1e-12))
    around = [conventions.pose_distance(*pair)[1] for pair in ((A, C), (C, B))]
    assert there[1] <= sum(around) + 1e-9


@STEADY
@given(coordinates, st.floats(0, np.pi))
def test_the_angle_of_a_rotation(axis, angle):
    if np.linalg.norm(axis) < 1e-3:
        axis = np.array([0.0, 0.0, 1.0])
    R = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
    assert conventions.rotation_angle(R) == pytest.approx(angle, abs=1e-9)


@STEADY
@given(angles, angles, angles)
def test_roll_pitch_yaw_are_those_of_urdf(roll, pitch, yaw):
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    np.testing.assert_allclose(conventions.rotation_rpy(roll, pitch, yaw), expected, atol=1e-12)


@STEADY
@given(poses(), arrays(np.float64, (3, 3), elements=st.floats(-1e-5, 1e-5)))
def test_a_pose_with_rounding_errors_becomes_the_nearest_rigid_one(T, noise):
    given_pose = T.copy()
    given_pose[:3, :3] += noise
    fixed = conventions.as_pose(given_pose)
    np.testing.assert_allclose(fixed[:3, :3].T @ fixed[:3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(fixed, T, atol=4e-5)
    np.testing.assert_allclose(conventions.as_pose(fixed), fixed, atol=1e-12)


@STEADY
@given(poses(), st.sampled_from(["mirror", "scale", "nan", "row"]))
def test_what_is_no_rigid_transform_is_refused(T, damage):
    wrong = T.copy()
    if damage == "mirror":
        wrong[:3, 0] *= -1
    elif damage == "scale":
        wrong[:3, :3] *= 1.001
    elif damage == "nan":
        wrong[1, 3] = np.nan
    else:
        wrong[3, 0] = 1e-6
    with pytest.raises(PoseError, match="the goal"):
        conventions.as_pose(wrong, "goal")


@STEADY
@given(angles, st.sampled_from([-1, 0, 1]), st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 0.3]), angles)
def test_roll_pitch_and_yaw_undo_each_other_also_straight_up_and_down(roll, pole, away, yaw):
    R = conventions.rotation_rpy(roll, pole * np.pi / 2 + away, yaw)
    np.testing.assert_allclose(conventions.rotation_rpy(*conventions.rpy_angles(R)), R, rtol=0, atol=1e-14)
