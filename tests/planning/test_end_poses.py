"""Starts and goals that cannot be: each is refused with one sentence that says which end and what is wrong."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import PoseError, RegraspError

BUILT_IN = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")
GOOD = translation(0.2, 0.35, 0.0)


def changed(**entries):
    """Return the upright bottle with entries such as ``r0c3=0.5`` of its pose replaced."""
    T = GOOD.copy()
    for name, value in entries.items():
        T[int(name[1]), int(name[3])] = value
    return T


def turned(angle):
    T = GOOD.copy()
    T[1:3, 1:3] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T


BAD = {
    "nan": (changed(r0c3=np.nan), "NaN"),
    "infinite": (changed(r2c3=np.inf), "infinity"),
    "shape": (np.eye(3), r"shape \(3, 3\)"),
    "batch": (GOOD[None], r"shape \(1, 4, 4\)"),
    "text": ("upright", "not a numeric 4x4 matrix"),
    "none": (None, "shape"),
    "ragged": ([[1, 0, 0], [0, 1]], "not a numeric 4x4 matrix"),
    "huge": ([[10**400] * 4] * 4, "not a numeric 4x4 matrix"),
    "scaled": (changed(r0c0=1.01), "not a rigid transform"),
    "sheared": (changed(r0c1=0.1), "not a rigid transform"),
    "last row": (changed(r3c0=0.1), "not a rigid transform"),
    "mirrored": (changed(r0c0=-1.0), "left-handed"),
    "floats": (changed(r2c3=0.01), "floats 10.0 mm above the table"),
    "sinks": (changed(r2c3=-0.01), "sinks 10.0 mm into the table"),
    "tilted": (turned(0.3), "sinks"),
    "outside": (changed(r0c3=0.6), "outside the workspace"),
    "behind": (changed(r1c3=-0.3), "outside the workspace"),
}


@pytest.mark.parametrize("end", ["start", "goal"])
@pytest.mark.parametrize("name", BAD)
def test_bad_ends_are_refused(bottle_problem, name, end):
    pose, said = BAD[name]
    ends = {"start": GOOD, "goal": GOOD, end: pose}
    with pytest.raises(PoseError, match=said) as info:
        solve_sequence(bottle_problem, **ends)
    assert "\n" not in str(info.value) and end in str(info.value)


@pytest.mark.parametrize("gap", [5e-4, -5e-4])
def test_a_gap_within_the_tolerance_is_accepted(bottle_problem, gap):
    assert solve_sequence(bottle_problem, changed(r2c3=gap), GOOD, max_regrasps=0).poses.shape == (2, 4, 4)


def problem_with(tmp_path, text):
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return RegraspProblem.load("bottle", path)


OBSTACLE = """
[[obstacles]]
type = "box"
name = "crate"
position = [0.24, 0.35, 0.05]
size = [0.04, 0.04, 0.1]
"""


@pytest.mark.parametrize("end", ["start", "goal"])
def test_an_obstacle_in_the_place_is_named(tmp_path, end):
    problem = problem_with(tmp_path, BUILT_IN + OBSTACLE)
    free = translation(-0.2, 0.35, 0.0)
    with pytest.raises(PoseError, match=f"overlaps the obstacle 'crate' at the {end} pose"):
        solve_sequence(problem, **{"start": free, "goal": free, end: GOOD})


@pytest.mark.parametrize("end", ["start", "goal"])
def test_the_robots_base_in_the_place_is_named(tmp_path, end):
    problem = problem_with(tmp_path, BUILT_IN.replace("y = [0.1, 0.6]", "y = [0.0, 0.6]"))
    with pytest.raises(PoseError, match=f"overlaps the robot's base at the {end} pose"):
        solve_sequence(problem, **{"start": GOOD, "goal": GOOD, end: translation(0.0, 0.05, 0.0)})


@pytest.mark.parametrize("end", ["start", "goal"])
def test_a_pose_out_of_reach_is_refused(tmp_path, end):
    wide = BUILT_IN.replace("size = [1.4, 1.2]", "size = [4.0, 4.0]").replace("y = [0.1, 0.6]", "y = [0.1, 2.0]")
    problem = problem_with(tmp_path, wide)
    with pytest.raises(PoseError, match=f"the {end} pose is out of reach"):
        solve_sequence(problem, **{"start": GOOD, "goal": GOOD, end: translation(0.0, 1.9, 0.0)})


def test_feasible_grasps_wants_a_rigid_pose(bottle_problem):
    for pose in (np.full((4, 4), np.nan), np.eye(3), np.diag([-1.0, 1, 1, 1]), "pose"):
        with pytest.raises(PoseError):
            bottle_problem.feasible_grasps(pose)


def test_a_raised_table_raises_the_placements(tmp_path):
    raised = BUILT_IN.replace("height = 0.0", "height = -0.05")
    problem = problem_with(tmp_path, raised)
    for placement in problem.placements:
        lowest = (problem.object.vertices @ placement.pose[2, :3] + placement.pose[2, 3]).min()
        assert lowest == pytest.approx(-0.05, abs=1e-9)
    with pytest.raises(PoseError, match=r"floats 50\.0 mm"):
        solve_sequence(problem, GOOD, GOOD)


def test_without_a_prepared_model_the_arms_energy_serves_and_the_papers_is_asked_for(tmp_path):
    problem = problem_with(tmp_path, BUILT_IN.replace("arm = 0.005", "arm = 0.006"))
    assert problem.model_folder is None and problem.energy.model.features == "arm"
    with pytest.raises(RegraspError, match=r"regrasp-opt prepare \S*cell.toml --object bottle") as info:
        _ = replace(problem, preset="paper").energy
    assert "\n" not in str(info.value)
