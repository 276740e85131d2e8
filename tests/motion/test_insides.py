"""Robot and object inside closed meshes: refused by the check, the certificate and the motion verification alike."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from regrasp_opt.conventions import translation
from regrasp_opt.errors import PoseError
from regrasp_opt.geometry.shapes import Mesh
from regrasp_opt.motion.trajectory.collision_context import MotionScene
from regrasp_opt.motion.trajectory.continuous_collision import verify
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.planning.ends import checked_end


def mesh(name, *parts, at=(0.0, 0.0, 0.0)):
    whole = trimesh.util.concatenate(parts)
    return Mesh(name, np.array(whole.vertices), np.array(whole.faces), translation(*at))


def box(size, inward=False):
    made = trimesh.creation.box(size)
    if inward:
        made.invert()
    return made


SOLID = mesh("room", box((8, 8, 8)))
INSIDE_OUT = mesh("room", box((8, 8, 8), inward=True))
HOLLOW = mesh("room", box((8, 8, 8)), box((7, 7, 7), inward=True))


def within(problem, *obstacles):
    return replace(problem, workcell=replace(problem.workcell, obstacles=obstacles))


@pytest.mark.parametrize("room", [SOLID, INSIDE_OUT], ids=["outward", "inside out"])
def test_nothing_is_feasible_inside_a_closed_mesh(bottle_plan, room):
    problem, transition = within(bottle_plan.problem, room), bottle_plan.transitions[0]
    assert "room" in problem.checker.object_problem(bottle_plan.poses[0])
    assert not problem.checker.feasible(bottle_plan.poses[0]).any()
    grasp_id, q = int(transition.grasp_ids[0]), transition.q_pick[0]
    assert not problem.checker.is_free(bottle_plan.poses[0], grasp_id, q)
    assert problem.checker.clearance(bottle_plan.poses[0], grasp_id, q) < -0.005
    residuals = replace(bottle_plan, problem=problem).residuals()
    assert not residuals.hold and any("room" in text for text in residuals.problems)
    with pytest.raises(PoseError, match="overlaps the obstacle 'room'"):
        checked_end(bottle_plan.poses[0], "start", problem)


def test_a_room_with_walls_is_free_within(bottle_plan):
    problem, transition = within(bottle_plan.problem, HOLLOW), bottle_plan.transitions[0]
    T = bottle_plan.poses[0]
    np.testing.assert_array_equal(problem.checker.feasible(T), bottle_plan.problem.checker.feasible(T))
    clearances = [
        p.checker.clearance(T, int(transition.grasp_ids[0]), transition.q_pick[0])
        for p in (problem, bottle_plan.problem)
    ]
    assert clearances[0] == clearances[1] > 0
    assert replace(bottle_plan, problem=problem).residuals().hold


def test_an_object_and_an_obstacle_may_not_be_inside_each_other(bottle_plan):
    T = bottle_plan.poses[0]
    middle = T[:3, 3] + T[:3, :3] @ bottle_plan.problem.object.center_of_mass
    for size in (0.6, 0.01):  # around the bottle, and in it
        checker = within(bottle_plan.problem, mesh("block", box([size] * 3), at=middle)).checker
        assert checker.object_overlaps(T, 0.0) == "the obstacle 'block'"
        assert checker.object_overlaps(translation(1.5, 0.0, 0.0) @ T, 0.0) is None


@pytest.mark.parametrize(("room", "holds"), [(SOLID, False), (HOLLOW, True)], ids=["solid", "hollow"])
def test_motions_inside_a_closed_mesh_are_refused(bottle_plan, room, holds):
    scene = MotionScene(within(bottle_plan.problem, room))
    q = bottle_plan.problem.workcell.robot.home
    grasp_id = int(bottle_plan.transitions[0].grasp_ids[0])
    for setting in (scene.beside(bottle_plan.poses[0], (0.06, 0.08)), scene.holding(grasp_id)):
        assert [setting.passes(q, level) for level in (0, 9)] == [holds, holds]
        move = Trajectory(np.array([0.0, 1.0]), np.array([q, q + 0.02]), np.zeros((2, len(q))))
        assert verify(setting, move) == holds
