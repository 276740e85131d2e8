"""The POSE argument: what it means, and that nothing typed there ends in anything but a pose or a PoseError."""

import json

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from regrasp_opt.conventions import planar_transform, pose_distance
from regrasp_opt.errors import PoseError
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.pose_text import describe_pose, parse_pose

PROBLEM = RegraspProblem.load("bottle", "nova2-w")
PLACEMENTS = PROBLEM.placement_poses
STEADY = settings(deadline=None, derandomize=True, max_examples=100)
numbers = st.floats(-10, 10)


def assert_pose_or_refusal(text):
    try:
        T = parse_pose(text, "goal", PROBLEM)
    except PoseError as error:
        assert "goal" in str(error)
        return
    assert T.shape == (4, 4) and np.isfinite(T).all()
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3)


@STEADY
@given(st.integers(0, 2), numbers, numbers, st.floats(-1000, 1000))
def test_the_short_form_is_a_moved_placement(number, x, y, degrees):
    for text in (f"{number}:{x!r},{y!r},{degrees!r}", f" {number}: {x!r} , {y!r} ,{degrees!r} "):
        expected = planar_transform([x, y, np.deg2rad(degrees)]) @ PLACEMENTS[number]
        np.testing.assert_allclose(parse_pose(text, "start", PROBLEM), expected, atol=1e-12)


@STEADY
@given(st.integers(0, 2), numbers, numbers, st.floats(-180, 180))
def test_what_is_printed_of_a_pose_can_be_given_again(number, x, y, degrees):
    T = planar_transform([x, y, np.deg2rad(degrees)]) @ PLACEMENTS[number]
    again = parse_pose(describe_pose(T, PROBLEM), "start", PROBLEM)
    distance, angle = pose_distance(T, again)
    assert distance < 1e-3 and angle < np.deg2rad(0.1)


def test_a_pose_off_the_table_is_printed_as_where_it_is():
    T = planar_transform([0.1, 0.2, 0.3]) @ PLACEMENTS[0]
    T[2, 3] += 0.01
    assert describe_pose(T, PROBLEM) == f"({T[0, 3]:+.3f}, {T[1, 3]:+.3f}, {T[2, 3]:+.3f})"


def test_the_example_of_the_documentation():
    T = parse_pose("2:0.30,0.25,90", "start", PROBLEM)
    (x, y, z), (px, py, pz) = T[:3, 3], PLACEMENTS[2][:3, 3]
    np.testing.assert_allclose([x, y, z], [0.3 - py, 0.25 + px, pz])
    np.testing.assert_allclose(T[:3, :3].T @ [0.0, 1.0, 0.0], PLACEMENTS[2][:3, :3].T @ [1.0, 0.0, 0.0], atol=1e-12)


NO_POSES = [
    "5:0,0,0", "-1:0,0,0", "0:0,0", "0:0,0,0,0", "0:,,", "0:x,0,0", ":0,0,0", "", "0:1e999,0,0", "0:0,0,nan",
    "1.5:0,0,0", "0;0,0,0", "9" * 5000 + ":0,0,0", "a" * 5000, "a\0b", "\0.json",
]  # fmt: skip


@pytest.mark.parametrize("text", NO_POSES, ids=lambda text: ascii(text[:20]))
def test_what_is_no_pose_is_refused(text):
    with pytest.raises(PoseError) as info:
        parse_pose(text, "start", PROBLEM)
    assert "start" in str(info.value)


def test_text_that_is_no_pose_is_told_from_a_file_that_is_not_there(tmp_path):
    with pytest.raises(PoseError, match=r"'upright' is not a pose; write it like 2:0\.30,0\.25,45 or name a JSON file"):
        parse_pose("upright", "start", PROBLEM)
    with pytest.raises(PoseError, match=r"cannot read the goal from '.*start\.json': No such file"):
        parse_pose(str(tmp_path / "start.json"), "goal", PROBLEM)


def test_a_file_of_any_name_may_hold_a_pose(tmp_path):
    for name in ("pose.txt", "pose"):
        (tmp_path / name).write_text(json.dumps(PLACEMENTS[1].tolist()), encoding="utf-8")
        np.testing.assert_array_equal(parse_pose(str(tmp_path / name), "start", PROBLEM), PLACEMENTS[1])


@STEADY
@given(st.text(max_size=300))
@example("0:0,0,0\n")
def test_any_text_is_a_pose_or_is_refused(text):
    assert_pose_or_refusal(text)


@STEADY
@given(st.text("0123456789:,.+-eEnaif _", max_size=40))
def test_nearly_a_pose_is_a_pose_or_is_refused(text):
    assert_pose_or_refusal(text)


@pytest.fixture(scope="module")
def pose_file(tmp_path_factory):
    return tmp_path_factory.mktemp("poses") / "pose.json"


entries = st.one_of(st.floats(allow_nan=True), st.integers(), st.none(), st.booleans(), st.text(max_size=3))
values = st.one_of(
    st.recursive(entries, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=2), inner)),
    st.lists(st.lists(entries, min_size=4, max_size=4), min_size=4, max_size=4),
)


@STEADY
@given(values)
@example([[10**400] * 4] * 4)
def test_any_json_is_a_pose_or_is_refused(pose_file, value):
    pose_file.write_text(json.dumps(value), encoding="utf-8")
    assert_pose_or_refusal(str(pose_file))


@STEADY
@given(st.integers(0, 2), numbers, numbers, st.floats(-7, 7))
def test_a_file_gives_back_the_pose_that_was_written(pose_file, number, x, y, yaw):
    T = planar_transform([x, y, yaw]) @ PLACEMENTS[number]
    pose_file.write_text(json.dumps(T.tolist()), encoding="utf-8")
    np.testing.assert_allclose(parse_pose(str(pose_file), "start", PROBLEM), T, atol=1e-12)
