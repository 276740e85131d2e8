"""Goals for ROS 2, read as messages by rosbags: the verified motion, in order, and when the jaw moves."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import yaml
from messages import received
from scipy.interpolate import BPoly, CubicHermiteSpline, CubicSpline

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.errors import PlanFileError
from regrasp_opt.io.ros_export import GRIP_FORCE, ros_goals, save_ros
from regrasp_opt.motion import MotionPlan, MotionStatus, Phase, Segment, Trajectory, plan_motion
from regrasp_opt.motion.trajectory.jaw_events import Squeeze

TRAJECTORY, GRIPPER = "trajectory_msgs/msg/JointTrajectory", "control_msgs/msg/GripperCommand"


@pytest.fixture(scope="module")
def goals(motion, tmp_path_factory):
    path = tmp_path_factory.mktemp("ros") / "goals.yaml"
    save_ros(motion, path)
    content = yaml.safe_load(path.read_text("utf-8"))
    arm = motion.plan.problem.workcell.arm
    assert (content["arm"], content["gripper"]) == (arm.robot.name, arm.end_effector.name)
    return [(goal, received(goal["type"], goal["message"])) for goal in content["goals"]]


def rows(message, name):
    return np.array([getattr(point, name) for point in message.points])


def times(message):
    return np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points])


def test_trajectories_are_the_motion_between_jaw_moves(motion, goals):
    moving = iter([s for s in motion.segments if s.phase not in (Phase.GRASP, Phase.RELEASE)])
    sent = [(goal, message) for goal, message in goals if goal["type"] == TRAJECTORY]
    for goal, message in sent:
        t, start = times(message), 0.0
        assert t[0] == 0 and (np.diff(t) > 0).all()
        assert tuple(message.joint_names) == motion.plan.problem.workcell.arm.robot.joint_names
        spline = CubicHermiteSpline(t, rows(message, "positions"), rows(message, "velocities"))
        for phase, segment in zip(goal["phases"], moving, strict=False):
            assert phase == segment.phase.name.lower()
            local = np.linspace(0.0, segment.trajectory.duration, 40)
            np.testing.assert_allclose(spline(start + local), segment.trajectory.at(local), rtol=0, atol=1e-7)
            start += segment.trajectory.duration
        assert t[-1] == pytest.approx(start, abs=1e-9)
        assert not np.any([message.points[0].velocities, message.points[-1].velocities])
        np.testing.assert_allclose(rows(message, "accelerations"), spline(t, 2), atol=0.02)
    assert next(moving, None) is None
    for (_, before), (_, after) in itertools.pairwise(sent):
        assert np.array_equal(before.points[-1].positions, after.points[0].positions)


def test_the_jaw_squeezes_and_opens_between_the_trajectories(motion, goals):
    waited = [(goal["type"], message) for goal, message in goals if "during" not in goal]
    assert [kind for kind, _ in waited] == [GRIPPER, TRAJECTORY] * (1 + 2 * len(motion.plan.transitions))
    asked = [message.position for kind, message in waited if kind == GRIPPER]
    moves = [s for s in motion.segments if s.phase in (Phase.GRASP, Phase.RELEASE)]
    wanted = [s.jaw[1] - motion.squeeze.below_contact * (s.phase is Phase.GRASP) for s in moves]
    assert asked == pytest.approx([motion.segments[0].jaw[0], *wanted], abs=1e-12)
    assert {message.max_effort for kind, message in waited if kind == GRIPPER} == {GRIP_FORCE}


def test_a_jaw_that_moves_on_the_way_is_told_when(motion):
    """Between two transitions the jaw takes its next opening while the arm reaches."""
    reach = next(k for k, s in enumerate(motion.segments) if s.phase is Phase.REACH and s.transition == 1)
    segments = list(motion.segments)
    segments[reach] = replace(segments[reach], jaw=(segments[reach].jaw[0], segments[reach].jaw[0] + 0.01))
    found = ros_goals(replace(motion, segments=tuple(segments)))["goals"]
    (number,) = [k for k, goal in enumerate(found) if goal.get("during")]
    before = found[number - 1]
    assert before["phases"] == ["retreat", "reach", "approach"]
    assert found[number]["during"] == pytest.approx(motion.starts[reach] - motion.starts[reach - 1], abs=1e-9)
    assert found[number]["message"]["position"] == segments[reach].jaw[1]


def test_accelerations_are_sent_where_quintics_through_them_are_the_motion(motion):
    t = np.array([0.0, 0.1, 0.35, 0.5, 0.9])
    spline = CubicSpline(t, np.random.default_rng(0).normal(size=(5, 6)), bc_type="clamped")
    smooth = Trajectory(t, spline(t), spline(t, 1))
    bent = replace(smooth, velocities=smooth.velocities + 0.5 * np.array([0, 0, 1, 0, 0])[:, None])
    for trajectory, sends in ((smooth, True), (bent, False)):
        alone = replace(motion, segments=(Segment(Phase.REACH, 0, 0, trajectory, (0.05, 0.05)),))
        (goal,) = (goal for goal in ros_goals(alone)["goals"] if goal["type"] == TRAJECTORY)
        message = received(TRAJECTORY, goal["message"])
        if sends:
            known = [rows(message, name) for name in ("positions", "velocities", "accelerations")]
            quintic = BPoly.from_derivatives(t, np.stack(known, axis=1))
            dense = np.linspace(0.0, 0.9, 200)
            np.testing.assert_allclose(quintic(dense), spline(dense), atol=1e-9)
        else:
            assert all(len(point.accelerations) == 0 for point in message.points)


def test_a_force_and_a_squeeze_that_were_asked_for_are_sent(motion):
    asked = ros_goals(replace(motion, squeeze=Squeeze(0.001, 25.0)))["goals"]
    told = [goal["message"] for goal in asked if goal["type"] == GRIPPER]
    width = motion.plan.problem.grasps.width[motion.segments[0].grasp_id]
    assert told[1] == {"position": pytest.approx(width - 0.001, abs=1e-12), "max_effort": 25.0}
    assert told[0]["max_effort"] == told[2]["max_effort"] == GRIP_FORCE


def test_suction_is_switched(tmp_path):
    problem = RegraspProblem.load("bottle", "nova2-s1")
    T = problem.pose(0, 0.1, 0.35)
    motion = plan_motion(solve_sequence(problem, T, problem.pose(0, 0.15, 0.35)))
    assert motion.solved, motion.reason
    found = ros_goals(motion)["goals"]
    switched = [received(g["type"], g["message"]).data for g in found if g["type"] == "std_msgs/msg/Bool"]
    assert switched == [False, True, False] and not [g for g in found if g["type"] == GRIPPER]


def test_no_motion_is_refused(motion, tmp_path):
    unsolved = MotionPlan(MotionStatus.NO_MOTION, "blocked", motion.plan, (), *[np.ones(6)] * 2, 0.0)
    with pytest.raises(PlanFileError, match="blocked"):
        save_ros(unsolved, tmp_path / "goals.yaml")
    assert not list(tmp_path.iterdir())
