"""What the table rules out: never a feasible grasp, and no fewer than the gripper's corners in it."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.connectivity import TableRule
from regrasp_opt.conventions import planar_transform
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.tabletop import points_in_table, wrist_bodies
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.objects import load_object
from regrasp_opt.workcell import load_workcell
from regrasp_opt.workcell.model import Table


def rule(cell, grasps, placements):
    corners = cell.table.center + np.array([[-0.5], [0.5]]) * cell.table.size
    return TableRule(points_in_table(cell, grasps, placements), corners)


@pytest.mark.parametrize(
    ("name", "cell_name"), [("bottle", "nova2-w"), ("mug", "nova2-s2"), ("figurine", "nova2-r140")]
)
@pytest.mark.parametrize("size", [(1.4, 1.2), (1.0, 0.7)])
def test_no_feasible_grasp_is_ruled_out(name, cell_name, size):
    cell = load_workcell(cell_name)
    table = cell.table
    cell = replace(cell, table=Table(table.height, table.center, np.array(size), table.thickness))
    model = load_object(name)
    grasps = sample_grasps(model, cell.end_effector, 60, seed=2)
    placements = np.array([p.pose for p in model.placements])
    checker, ruled_out = FeasibilityChecker(model, cell, grasps), rule(cell, grasps, placements)
    rng = np.random.default_rng(0)
    numbers = rng.integers(len(placements), size=60)
    xi = np.column_stack([rng.uniform(*cell.bounds.array, (60, 2)), rng.uniform(-np.pi, np.pi, 60)])
    feasible = np.array([checker.feasible(T) for T in planar_transform(xi) @ placements[numbers]])
    verdict = ruled_out(numbers, xi)
    assert feasible.any() and verdict.any()
    assert not (feasible & verdict).any()


def test_the_rule_holds_where_the_point_is_within_the_edges():
    point = np.array([[[0.2, 0.0], [np.nan, np.nan]]])
    ruled_out = TableRule(point, np.array([[-0.5, 0.0], [0.5, 1.0]]))
    xi = np.array([[0.0, 0.5, 0.3], [0.4, 0.5, 0.0], [0.4, 0.5, np.pi], [0.0, 0.85, np.pi / 2], [0.0, 2.0, 0.0]])
    verdict = ruled_out(np.zeros(5, dtype=int), xi)
    assert verdict.tolist() == [[True, False], [False, False], [True, False], [False, False], [False, False]]


def test_bodies_round_about_the_last_joint_belong_to_the_wrist():
    robot = load_workcell("nova2-w").robot
    before = robot.chain.forward(np.zeros(robot.dof))
    bodies = wrist_bodies(robot)
    assert len(bodies) > sum(item.parentJoint == robot.dof for item in robot.collision.geometryObjects)
    names = {id(geometry) for geometry, _ in bodies}
    assert len(names) == len(bodies)
    for q6 in (0.7, -2.0):
        q = np.zeros(robot.dof)
        q[-1] = q6
        links = robot.link_transforms(q)
        flange = robot.forward(q)
        for item in robot.collision.geometryObjects:
            world = (np.eye(4) if item.parentJoint == 0 else links[item.parentJoint - 1]) @ item.placement.homogeneous
            for geometry, T in bodies:
                if geometry is item.geometry:
                    np.testing.assert_allclose((flange @ T)[:3, 3], world[:3, 3], atol=1e-9)
                    np.testing.assert_allclose(abs((flange @ T)[:3, 2] @ world[:3, 2]), 1.0, atol=1e-9)
    assert not np.allclose(before, robot.forward(q))
