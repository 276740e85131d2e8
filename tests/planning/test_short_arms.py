"""Arms of few joints, which reach hardly any pose: planning says so and ends well."""

import pytest

from regrasp_opt import RegraspProblem, Status, solve_sequence

JOINTS = {"revolute": "0 0 1", "prismatic": "0 1 0"}


@pytest.mark.parametrize("kinds", [["revolute"], ["prismatic"], ["revolute"] * 3])
def test_planning_with_a_short_arm_ends_without_a_plan(kinds, tmp_path):
    text = "<robot name='short'><link name='l0'/>"
    for i, kind in enumerate(kinds):
        text += (
            f"<link name='l{i + 1}'/><joint name='j{i}' type='{kind}'><parent link='l{i}'/><child link='l{i + 1}'/>"
            f"<origin xyz='0.1 0 0.3'/><axis xyz='{JOINTS[kind]}'/>"
            "<limit lower='-1' upper='1' velocity='1' effort='1'/></joint>"
        )
    (tmp_path / "short.urdf").write_text(text + "</robot>")
    (tmp_path / "cell.toml").write_text(
        "schema = 1\n[robot]\nmodel = 'short.urdf'\n[end_effector]\nmodel = 'w'\n[table]\ncenter = [0, 0]\n"
        "size = [1.8, 1.8]\n[workspace]\nx = [0.25, 0.6]\ny = [-0.4, 0.4]\n"
    )
    problem = RegraspProblem.load("bottle", tmp_path / "cell.toml")
    start, goal = problem.pose(0, 0.4, 0.1, 0.2), problem.pose(1, 0.4, -0.2, 1.0)
    assert not problem.feasible_grasps(start).any()
    assert solve_sequence(problem, start, goal, refiner="lattice").status == Status.START_INFEASIBLE
