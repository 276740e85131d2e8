"""Arms of few joints reach hardly any grasp drawn at random: refused, unless the grasps are given."""

import numpy as np
import pytest
from verifying import plan_problems

from regrasp_opt import RegraspProblem, load_workcell, solve_sequence
from regrasp_opt.errors import GraspError
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.objects import load_object

SCARA = [
    ("revolute", "0 0 0.5", "0 0 1", 2.8),
    ("revolute", "0.35 0 0", "0 0 1", 2.6),
    ("prismatic", "0.35 0 0", "0 0 1", 0.5),
    ("revolute", "0 0 0", "0 0 1", 3.1),
]


@pytest.fixture
def cell(tmp_path):
    text = "<robot name='scara'><link name='l0'/>"
    for i, (kind, xyz, axis, limit) in enumerate(SCARA):
        text += (
            f"<link name='l{i + 1}'/><joint name='j{i}' type='{kind}'><parent link='l{i}'/><child link='l{i + 1}'/>"
            f"<origin xyz='{xyz}'/><axis xyz='{axis}'/>"
            f"<limit lower='-{limit}' upper='{limit}' velocity='1' effort='1'/></joint>"
        )
    (tmp_path / "scara.urdf").write_text(text + "</robot>")
    (tmp_path / "cell.toml").write_text(
        f"schema = 1\n[robot]\nmodel = 'scara.urdf'\ntip_rpy = [{np.pi}, 0, 0]\n[end_effector]\nmodel = 'w'\n[table]\n"
        "center = [0, 0]\nsize = [1.8, 1.8]\n[workspace]\nx = [0.25, 0.6]\ny = [-0.4, 0.4]\n"
    )
    return load_workcell(tmp_path / "cell.toml")


def test_grasps_are_not_sampled_for_a_short_arm(cell):
    with pytest.raises(GraspError, match=r"'scara' has 4 joints .* give grasps that it reaches .* refiner 'exact'"):
        RegraspProblem.load("bottle", cell)


def test_a_scara_plans_with_grasps_from_above(cell):
    bottle = load_object("bottle")
    lying = bottle.placements[0].pose
    T = lying @ sample_grasps(bottle, cell.end_effector, 200).T_object_tcp
    steep = np.flatnonzero(T[:, 2, 2] < -0.7)
    y = T[steep, :3, 1] * (1, 1, 0)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    z = np.tile([0.0, 0.0, -1.0], (len(y), 1))
    T = T[steep]
    T[:, :3, :3] = np.stack([np.cross(y, z), y, z], axis=2)
    width = sample_grasps(bottle, cell.end_effector, 200).width[steep]
    problem = RegraspProblem.load("bottle", cell, grasps=GraspSet(np.linalg.inv(lying) @ T, width, "parallel"))
    plan = solve_sequence(problem, problem.pose(0, 0.4, 0.1, 0.2), problem.pose(0, 0.4, -0.2, 1.0), refiner="exact")
    assert plan.solved
    assert plan_problems(plan) == []
