"""The verifier of motions notices every kind of fault."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from verifying import motion_findings, plan_verifier

from oracles.motions import MotionVerifier
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.motion import Phase
from regrasp_opt.motion.trajectory.cartesian_path import line
from regrasp_opt.motion.trajectory.motion_plan import motion_content
from regrasp_opt.motion.trajectory.time_parameterization import through
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.robots import load_robot


def changed(motion, phase, **changes):
    """Return `motion` with the first segment of `phase` changed."""
    number = next(n for n, segment in enumerate(motion.segments) if segment.phase is phase)
    segments = list(motion.segments)
    segments[number] = replace(segments[number], **changes)
    return replace(motion, segments=tuple(segments)), segments[number]


def first(motion, phase):
    return next(segment for segment in motion.segments if segment.phase is phase)


COARSE = {"step": 5e-3, "turn": np.deg2rad(2.0)}
"""The faults below are larger."""


@pytest.fixture(scope="module")
def verifier(motion):
    return plan_verifier(motion.plan.problem)


@pytest.fixture(scope="module")
def verify(verifier):
    def find(motion):
        return motion_findings(motion, verifier, **COARSE)

    return find


@pytest.fixture(scope="module")
def problems(verify):
    def find(motion):
        return " | ".join(verify(motion).problems)

    return find


def test_a_good_motion_has_no_fault(motion, verifier):
    found = motion_findings(motion, verifier)
    assert found.problems == [] and found.collisions == 0
    assert found.samples > 4000
    assert 0.5 < found.velocity <= 1 + 1e-6 and 0.9 < found.acceleration <= 1 + 1e-6


def test_a_jaw_that_does_not_close_is_noticed(motion, problems):
    grasp = first(motion, Phase.GRASP)
    assert "does not close" in problems(changed(motion, Phase.GRASP, jaw=(grasp.jaw[0], grasp.jaw[0]))[0])
    assert "moves while it holds" in problems(changed(motion, Phase.LIFT, jaw=(grasp.jaw[1], grasp.jaw[1] + 0.01))[0])


def test_speeding_is_noticed(motion, problems):
    fast = first(motion, Phase.TRANSFER).trajectory.slowed(0.98)
    text = problems(changed(motion, Phase.TRANSFER, trajectory=fast)[0])
    assert "of its limit" in text and text.count("transition 0, transfer") >= 1


def test_a_jump_of_the_arm_and_of_the_jaw_is_noticed(motion, problems):
    path = first(motion, Phase.LIFT).trajectory
    shifted = Trajectory(path.times, path.positions + 1e-4, path.velocities)
    assert "the arm jumps" in problems(changed(motion, Phase.LIFT, trajectory=shifted)[0])
    assert "the jaw jumps" in problems(changed(motion, Phase.APPROACH, jaw=(0.05, 0.05))[0])


def test_a_jump_of_an_acceleration_is_noticed(motion, problems):
    """As fast at all knots as before, but in the middle of the return."""
    path = first(motion, Phase.RETURN).trajectory
    velocities = path.velocities.copy()
    velocities[len(velocities) // 2] *= 0.999
    jumping = Trajectory(path.times, path.positions, velocities)
    assert "an acceleration jumps by" in problems(changed(motion, Phase.RETURN, trajectory=jumping)[0])


@pytest.mark.parametrize("change", [{"time": 0.1}, {"command": 0.0}, {"force": 9.0}, {"holds": False}, None])
def test_a_wrong_command_to_the_jaw_is_noticed(motion, verifier, change):
    content = motion_content(motion)
    closing = next(n for n, event in enumerate(content["jaw_events"]) if event["holds"])
    if change is None:
        del content["jaw_events"][closing]
    else:
        content["jaw_events"][closing] |= change
    found = MotionVerifier(content, verifier).verify(content, **COARSE).problems
    assert len(found) == 1 and ("jaw event" in found[0] or "the jaw is told" in found[0])


def test_too_much_jerk_is_noticed(motion, problems):
    assert "the jerk is" in problems(replace(motion, jerk_limits=np.full(6, 20.0)))


def test_a_missing_phase_is_noticed(motion, problems):
    without = tuple(s for s in motion.segments if s.phase is not Phase.RELEASE)
    assert "has the phases" in problems(replace(motion, segments=without))


def test_another_grasp_is_noticed(motion, problems):
    other = next(int(g) for g in motion.plan.transitions[0].grasp_ids if g != first(motion, Phase.GRASP).grasp_id)
    assert "misses the grasp" in problems(changed(motion, Phase.GRASP, grasp_id=other)[0])


def test_a_way_through_the_table_is_noticed(motion, problems):
    """The lift is replaced by a dive of 30 mm and back."""
    lift = first(motion, Phase.LIFT).trajectory
    robot = motion.plan.problem.workcell.robot
    dive = through(line(robot, lift.positions[0], np.array([0.0, 0.0, -1.0]), 0.03))
    s = np.linspace(0, 1, 20)
    positions = np.concatenate([dive(s), dive(s[::-1])[1:], lift.positions[1:]])
    times = np.linspace(0, 30, len(positions))
    text = problems(changed(motion, Phase.LIFT, trajectory=Trajectory(times, positions, np.zeros_like(positions)))[0])
    assert "object sinks into table" in text and "meets table" in text


def test_a_transfer_that_scrapes_over_the_table_is_noticed(motion, verify):
    """Carrying the object from grasp to release without lifting it collides."""
    lift, lower = first(motion, Phase.LIFT).trajectory, first(motion, Phase.LOWER).trajectory
    ends = np.array([lift.positions[0], lower.positions[-1]])
    low = Trajectory(np.array([0.0, 20.0]), ends, np.zeros_like(ends))
    found = verify(changed(motion, Phase.TRANSFER, trajectory=low)[0])
    assert found.collisions > 0 and "object meets table" in " ".join(found.problems)


def test_an_approach_with_too_wide_a_hand_is_noticed(motion, verify):
    """Turned by a quarter about its axis, the palm and fingers run into the object or what is beside it."""
    path = first(motion, Phase.APPROACH).trajectory
    turned = Trajectory(path.times, path.positions + np.pi / 2 * np.eye(6)[5], path.velocities)
    found = verify(changed(motion, Phase.APPROACH, trajectory=turned)[0])
    assert found.collisions > 0 and "object meets" in " ".join(found.problems)


def test_joints_beyond_their_limits_are_noticed(motion, problems):
    path = first(motion, Phase.RETURN).trajectory
    turned = Trajectory(path.times, path.positions + 4 * np.pi * np.eye(6)[5], path.velocities)
    assert "a joint leaves its limits" in problems(changed(motion, Phase.RETURN, trajectory=turned)[0])


def test_an_arm_that_moves_while_the_jaw_closes_is_noticed(motion, problems):
    path = first(motion, Phase.GRASP).trajectory
    drifting = path.positions + 1e-3 * np.linspace(0, 1, len(path.times))[:, None]
    moved = Trajectory(path.times, drifting, path.velocities)
    assert "transition 0, grasp: the arm does not rest" in problems(changed(motion, Phase.GRASP, trajectory=moved)[0])


def test_a_grasp_that_both_poses_do_not_share_is_noticed(motion, problems):
    shared = set(motion.plan.transitions[0].grasp_ids.tolist())
    other = next(g for g in range(len(motion.plan.problem.grasps)) if g not in shared)
    text = problems(changed(motion, Phase.LIFT, grasp_id=other)[0])
    assert "the grasp is not shared by the two poses" in text and "changes the grasp on its way" in text


def test_obstacles_of_every_kind_are_met(motion):
    """Each stands where the hand is in the middle of the transfer."""
    problem, path = motion.plan.problem, first(motion, Phase.TRANSFER).trajectory
    hand = problem.workcell.T_world_base @ problem.workcell.robot.forward(path.positions[len(path.positions) // 2])
    here = np.eye(4)
    here[:3, 3] = hand[:3, 3]
    cube = trimesh.creation.box((0.05, 0.05, 0.05))
    for obstacle in (
        Box("cube", np.full(3, 0.05), here),
        Cylinder("post", 0.03, 0.05, here),
        Mesh("part", np.array(cube.vertices), np.array(cube.faces), here),
    ):
        cell = replace(problem.workcell, obstacles=(obstacle,))
        plan = replace(motion.plan, problem=replace(problem, workcell=cell))
        found = motion_findings(replace(motion, plan=plan, segments=(first(motion, Phase.TRANSFER),)), **COARSE)
        assert found.collisions > 0 and f"meets {obstacle.name}" in " ".join(found.problems)


RAIL = """<robot name="arm"><link name="base"/><link name="sledge"/><link name="tool0"/>
<joint name="rail" type="prismatic"><parent link="base"/><child link="sledge"/><origin xyz="0 0 0.3" rpy="0.2 0 0"/>
<axis xyz="0.6 0.8 0"/><limit lower="-0.4" upper="0.4" velocity="1" effort="1"/></joint>
<joint name="turn" type="revolute"><parent link="sledge"/><child link="tool0"/><origin xyz="0.1 0 0" rpy="0 0.4 0"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint></robot>"""


@pytest.mark.parametrize("q", np.random.default_rng(0).uniform(-0.2, 0.2, (5, 2)))
def test_rails_are_driven_along_their_axes(motion, tmp_path, q):
    """The object is put where the hand holds it; moved along the rail by 0.01 mm the hand misses it."""
    path = tmp_path / "arm.urdf"
    path.write_text(RAIL, encoding="utf-8")
    plan, grasp, robot = motion.plan, first(motion, Phase.GRASP), load_robot(path)
    cell = replace(plan.problem.workcell, arm=replace(plan.problem.workcell.arm, robot=robot))
    tcp = cell.T_world_base @ robot.forward(q) @ np.linalg.inv(cell.end_effector.T_tcp_flange)
    poses = plan.poses.copy()
    poses[0] = tcp @ np.linalg.inv(plan.problem.grasps.T_object_tcp[grasp.grasp_id])
    plan = replace(plan, problem=replace(plan.problem, workcell=cell), poses=poses)

    def missed(along):
        times, there = grasp.trajectory.times, np.tile(q + np.array([along, 0.0]), (len(grasp.trajectory.times), 1))
        still = replace(grasp, trajectory=Trajectory(times, there, np.zeros_like(there)))
        limits = {"velocity_limits": np.ones(2), "acceleration_limits": np.ones(2)}
        found = motion_findings(replace(motion, plan=plan, segments=(still,), **limits), **COARSE)
        return any("misses the grasp" in text for text in found.problems)

    assert not missed(0.0) and missed(1e-5)
