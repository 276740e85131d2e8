"""Robots that are known by name, and the workcells that are built in with them."""

import numpy as np
import pytest

from regrasp_opt.conventions import invert
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.feasibility.tool_poses import label_tool_poses
from regrasp_opt.robots import EXAMPLE_ROBOT_NAMES, ROBOT_NAMES, load_robot, loading
from regrasp_opt.scene import FURTHER_WORKCELL_NAMES, load_workcell

DOWN = (0.0, 0.0, -1.0)


@pytest.mark.parametrize("name", (*ROBOT_NAMES, *EXAMPLE_ROBOT_NAMES))
def test_robots_load_by_name_with_a_home_and_an_analytic_solver(name):
    robot = load_robot(name)
    assert robot.name == name and robot.ik_test.solver.startswith("analytic")
    assert robot.ik_test.solved == robot.ik_test.tried and robot.within_limits(robot.home)
    assert load_robot(name, home=np.zeros(robot.dof) + robot.home).fingerprint() == robot.fingerprint()


@pytest.mark.parametrize("name", FURTHER_WORKCELL_NAMES)
def test_the_tool_looks_down_at_home_and_may_be_where_objects_are_put(name):
    cell = load_workcell(name)
    T = cell.arm.T_world_tcp(cell.robot.home)
    np.testing.assert_allclose(T[:3, 2], DOWN, atol=0.02)
    assert cell.source == "built-in" and T[2, 3] > cell.table.height + 0.1
    middle, corners = T.copy(), [(x, y) for x in cell.bounds.x for y in cell.bounds.y]
    for x, y in [np.mean([cell.bounds.x, cell.bounds.y], axis=1), *corners]:
        middle[:3, 3] = x, y, cell.table.height + 0.05
        flange = middle @ cell.end_effector.T_tcp_flange
        assert len(cell.robot.solve_ik(invert(cell.T_world_base) @ flange).q), (x, y)


@pytest.mark.parametrize("name", ["panda-w", "z1-w"])
def test_tool_poses_of_other_arms_are_feasible(name):
    labels = label_tool_poses(load_workcell(name), 1000, jobs=1)
    assert 0.05 < labels.feasible.mean() < 0.95


def test_what_a_name_leaves_out_can_be_kept():
    assert "panda_hand" not in {f.name for f in load_robot("panda").model.frames}
    whole = load_robot("panda", tip="panda_hand_tcp", leave_out=[])
    assert whole.tip_frame == "panda_hand_tcp" and whole.collision.ngeoms > load_robot("panda").collision.ngeoms


def test_a_name_that_is_close_is_named_first():
    with pytest.raises(UnknownNameError) as info:
        load_robot("ur55")
    assert info.value.alternatives[0] == "ur5"


def test_the_extra_is_named_where_it_is_missing(monkeypatch, tmp_path):
    def missing(name):
        raise loading.PackageNotFoundError(name)

    monkeypatch.setattr(loading, "distribution", missing)
    load_robot("iiwa7")
    with pytest.raises(WorkcellError, match=r"the URDF of 'panda' is not installed; install .* regrasp-opt\[robots\]"):
        load_workcell("panda-w")
